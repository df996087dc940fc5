#include "avatar/osc.hpp"

#include <bit>

namespace facet::avatar {
namespace {

void append(std::vector<std::byte>& out, std::string_view text) {
  const auto bytes = std::as_bytes(std::span(text));
  out.insert(out.end(), bytes.begin(), bytes.end());
  // A text ends with a zero and is filled with zeros to four bytes.
  out.resize((out.size() + 4) / 4 * 4);
}

void append(std::vector<std::byte>& out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) {
    out.push_back(static_cast<std::byte>(value >> static_cast<unsigned>(shift)));
  }
}

}  // namespace

void OscBundles::add(std::string_view address, std::initializer_list<OscArgument> arguments) {
  message_.clear();
  append(message_, address);
  std::string tags = ",";
  for (const OscArgument& argument : arguments) {
    const auto* yes = std::get_if<bool>(&argument);
    tags += yes == nullptr ? "ifs"[argument.index()] : *yes ? 'T' : 'F';
  }
  append(message_, tags);
  for (const OscArgument& argument : arguments) {
    if (const auto* whole = std::get_if<std::int32_t>(&argument)) {
      append(message_, static_cast<std::uint32_t>(*whole));
    } else if (const auto* number = std::get_if<float>(&argument)) {
      append(message_, std::bit_cast<std::uint32_t>(*number));
    } else if (const auto* text = std::get_if<std::string_view>(&argument)) {
      append(message_, *text);
    }
  }
  if (bundles_.empty() || bundles_.back().size() + 4 + message_.size() > most_bytes_) {
    std::vector<std::byte>& bundle = bundles_.emplace_back();
    append(bundle, std::string_view("#bundle"));
    append(bundle, 0U);
    append(bundle, 1U);  // the time tag "immediately"
  }
  std::vector<std::byte>& bundle = bundles_.back();
  append(bundle, static_cast<std::uint32_t>(message_.size()));
  bundle.insert(bundle.end(), message_.begin(), message_.end());
}

}  // namespace facet::avatar
