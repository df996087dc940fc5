// Any bytes to the page's port: requests, parts of takes, handshakes and what follows them. Each gets an
// answer and an end.

#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstdint>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>

#include "service/control_server.hpp"
#include "service/web_server.hpp"
#include "stream/server.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace {

using namespace facet;

class Site {
 public:
  Site() : stream_(stream_config()), control_({folder_.path() / "control.sock", {}}, methods()) {
    std::filesystem::create_directory(folder_.path() / "page");
    std::filesystem::create_directory(folder_.path() / "takes");
    std::ofstream(folder_.path() / "page" / "index.html") << "<!doctype html><title>face</title>";
    take::TakeRecorder recorder({.file = folder_.path() / "takes" / "some.take",
                                 .source = "fuzzer",
                                 .software = "fuzzer",
                                 .when_full = take::WhenFull::Wait,
                                 .disk_reserve_bytes = 0});
    recorder.start();
    recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, test::patch_subject(), nullptr)));
    recorder.stop();
    stream_.start();
    service::WebConfig web;
    web.listen = "127.0.0.1:0";
    web.page = folder_.path() / "page";
    web.token_file = folder_.path() / "token";
    const std::filesystem::path takes = folder_.path() / "takes";
    web_.emplace(
        web, takes, [takes](const std::string& name) { return service::find_take(takes, name); }, stream_,
        control_);
  }

  void visit(std::string_view bytes) {
    const stream::FileDescriptor peer(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = ::htons(static_cast<std::uint16_t>(web_->port()));
    address.sin_addr.s_addr = ::htonl(INADDR_LOOPBACK);
    if (::connect(peer.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      __builtin_trap();
    }
    // None of the ports that a closed connection keeps for a minute is used up.
    const linger at_once{1, 0};
    ::setsockopt(peer.get(), SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    char piece[65536];
    for (;;) {
      if (!bytes.empty()) {
        const ssize_t sent = ::send(peer.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        bytes.remove_prefix(sent > 0 ? static_cast<std::size_t>(sent) : 0);
        if (bytes.empty()) {
          ::shutdown(peer.get(), SHUT_WR);
        }
      }
      control_.serve();
      pollfd events[] = {{peer.get(), POLLIN, 0}, {control_.fd(), POLLIN, 0}};
      if (::poll(events, 2, 10) == 0 && bytes.empty()) {
        return;  // half a request: nobody waits until the server has had enough of it
      }
      const ssize_t got = ::recv(peer.get(), piece, sizeof piece, MSG_DONTWAIT);
      if (got == 0 || (got < 0 && errno != EAGAIN)) {
        return;
      }
    }
  }

 private:
  stream::StreamServerConfig stream_config() const {
    stream::StreamServerConfig config;
    config.socket = folder_.path() / "stream.sock";
    return config;
  }
  static service::ControlMethods methods() {
    return {{"echo", {false, {{"text"}}, [](const nlohmann::json& params) { return params; }}}};
  }

  test::TemporaryFolder folder_;
  stream::StreamServer stream_;
  service::ControlServer control_;
  std::optional<service::WebServer> web_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Site site;
  site.visit({reinterpret_cast<const char*>(data), size});
  return 0;
}
