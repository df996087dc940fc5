// Lines to the control socket while a take is open: any of them gets an answer that is one line of valid
// JSON-RPC, or none. The first byte says who asks: somebody who may only look, in one line, or a member, in
// as many as there are, over the server's socket.

#include <sys/socket.h>

#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "facet/error.hpp"
#include "service/control_protocol.hpp"
#include "service/control_server.hpp"
#include "service/errands.hpp"
#include "service/studio_methods.hpp"
#include "stream/unix_socket.hpp"
#include "studio/studio.hpp"
#include "support/take_actor.hpp"

namespace {

using namespace facet;
using nlohmann::json;

void check_answer(std::string_view answer) {
  // The library's own reader: what is written must be JSON for everybody.
  const json response = json::parse(answer, nullptr, false);
  if (response.is_discarded() || answer.find('\n') != std::string_view::npos) {
    __builtin_trap();
  }
}

class OpenStudio {
 public:
  OpenStudio()
      : studio_(
            folder_.path(), [](auto&&) {}, [](bool) {}, "fuzzer") {
    constexpr int kFrames = 14;
    test::record_actor(folder_.path(), 1, kFrames);
    studio_.start();
    errands_.start();
    service::ControlMethods methods = service::studio_methods(studio_, errands_);
    methods.erase("keys.export");  // a take an input would fill the disk
    methods_ = methods;
    server_ = std::make_unique<service::ControlServer>(
        service::ControlConfig{folder_.path() / "control.sock", {}}, std::move(methods));
  }

  /// Opens the take where an input has closed it.
  void make_ready() {
    for (;;) {
      const studio::StudioStatus status = studio_.status();
      const bool is_open =
          status.state != studio::StudioState::Closed && status.state != studio::StudioState::Opening;
      if (is_open && status.posing) {
        return;
      }
      if (status.state != studio::StudioState::Opening) {
        studio_.open("actor1", true);
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  void look(std::string_view line) const {
    const std::string answer = answer_request(methods_, line, {1, 1000, false});
    if (!answer.empty()) {
      check_answer(answer);
    }
  }

  void command(std::string_view lines) {
    const stream::FileDescriptor client = stream::connect_unix(folder_.path() / "control.sock");
    std::string answers;
    char piece[65536];
    bool said_all = false;
    for (;;) {
      if (!lines.empty()) {
        const ssize_t sent = ::send(client.get(), lines.data(), lines.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        lines.remove_prefix(sent > 0 ? static_cast<std::size_t>(sent) : 0);
      } else if (!std::exchange(said_all, true)) {
        ::shutdown(client.get(), SHUT_WR);
      }
      server_->serve();
      const ssize_t got = ::recv(client.get(), piece, sizeof piece, MSG_DONTWAIT);
      if (got == 0 || (got < 0 && errno != EAGAIN)) {
        break;
      }
      answers.append(piece, got > 0 ? static_cast<std::size_t>(got) : 0);
    }
    for (std::string_view rest = answers; !rest.empty();) {
      const std::size_t end = rest.find('\n');
      if (end == std::string_view::npos) {
        break;  // the server hung up
      }
      check_answer(rest.substr(0, end));
      rest.remove_prefix(end + 1);
    }
  }

 private:
  test::TemporaryFolder folder_;
  studio::Studio studio_;
  service::Errands errands_{"facet-look"};
  service::ControlMethods methods_;
  std::unique_ptr<service::ControlServer> server_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static OpenStudio studio;
  if (size < 1) {
    return 0;
  }
  studio.make_ready();
  const std::string_view text(reinterpret_cast<const char*>(data + 1), size - 1);
  if ((data[0] & 1U) == 0) {
    studio.look(text);
  } else {
    studio.command(text);
  }
  return 0;
}
