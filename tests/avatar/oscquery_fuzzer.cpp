// What anybody in the network may say in a VRChat's name: the first byte says whether the rest is an answer
// of multicast DNS, an answer over HTTP in pieces, or JSON of one of three kinds. Each is bounded, or an
// Error(UnreadableInput).

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <string_view>

#include "avatar/oscquery.hpp"
#include "avatar/vrchat.hpp"
#include "facet/error.hpp"
#include "stream/http_get.hpp"

namespace {

using namespace facet;

void expect(bool holds) {
  if (!holds) {
    std::abort();
  }
}

void hear(std::span<const std::uint8_t> datagram) {
  const auto services = avatar::parse_mdns_answer(datagram);
  expect(services.size() <= avatar::kMostServices);
  for (const avatar::VrChatService& service : services) {
    expect(service.name.starts_with(avatar::kVrChatName) && service.name.size() <= 63);
    avatar::mdns_question(service.full_name(), 33);
  }
}

void get(std::string_view text, std::size_t piece) {
  constexpr std::size_t kMost = 300;
  stream::HttpAnswer answer(kMost);
  while (!text.empty() && answer.feed(text.substr(0, piece))) {
    text.remove_prefix(std::min(text.size(), piece));
  }
  if (text.empty()) {
    answer.feed("", true);
  }
  expect(answer.body().size() <= kMost);
}

template <typename Work>
void expect_unreadable(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    expect(error.kind() == ErrorKind::UnreadableInput);
  }
}

void read(std::string_view text) {
  expect_unreadable([&] { expect(avatar::parse_host_info(text).port != 0); });
  expect_unreadable([&] { expect(avatar::parse_avatar_change(text).size() <= 64); });
  expect_unreadable([&] {
    const avatar::AvatarParameters avatar = avatar::parse_avatar(text);
    expect(avatar.list.size() <= avatar::kMostAvatarParameters);
    avatar::VrChatWriter writer({}, &avatar);
    expect(writer.driven() <= static_cast<int>(avatar.list.size()));
    avatar::FaceState state;
    state.tracked = true;
    state.has_expression = true;
    state.values.fill(0.7F);
    avatar::OscBundles bundles(1400);
    writer.write(state, 0, bundles);
  });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) {
    return 0;
  }
  const std::span<const std::uint8_t> rest(data + 1, size - 1);
  const std::string_view text(reinterpret_cast<const char*>(rest.data()), rest.size());
  switch (data[0] % 4) {
    case 0:
      hear(rest);
      break;
    case 1:
      get(text, 1U + data[0] / 4);
      break;
    default:
      read(text);
  }
  return 0;
}
