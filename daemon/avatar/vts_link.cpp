#include "avatar/vts_link.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket_client.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;

constexpr auto kConnecting = 3s;
/// How long nothing may happen before the thread looks about.
constexpr auto kLook = 100ms;
/// What VTube Studio is not sent for a second it takes for lost; a face that holds still is sent again.
constexpr auto kAgain = 400ms;
/// A face of which no frame has come for so long is gone: nothing of it is sent any more.
constexpr auto kGone = 3s;

std::map<std::string, std::string> read_tokens(const std::filesystem::path& file) {
  std::map<std::string, std::string> tokens;
  const json text =
      files::parse_json(files::read_text(file, kMostVtsTokensBytes, "file of VTube Studio's tokens"),
                        {kMostVtsTokensBytes, 1000, 4}, file.string());
  try {
    if (text.at("facet_vts").get<int>() != 1) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("{}: is of a later release", file.string()));
    }
    for (const auto& [target, token] : text.at("tokens").items()) {
      tokens[target] = token.get<std::string>();
    }
  } catch (const json::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", file.string(), error.what()));
  }
  return tokens;
}

}  // namespace

struct VtsTokens::Impl {
  std::filesystem::path file;
  std::string fault;
  mutable Mutex mutex;
  std::map<std::string, std::string> tokens FACET_GUARDED_BY(mutex);
};

VtsTokens::VtsTokens(std::filesystem::path file) : impl_(std::make_unique<Impl>()) {
  impl_->file = std::move(file);
  std::error_code ignored;
  if (!std::filesystem::exists(impl_->file, ignored)) {
    return;
  }
  try {
    const Lock lock(impl_->mutex);
    impl_->tokens = read_tokens(impl_->file);
  } catch (const Error& error) {
    impl_->fault = fmt::format("{}; {}", error.what(), files::set_aside(impl_->file));
  }
}

VtsTokens::~VtsTokens() = default;

std::string VtsTokens::of(const std::string& target) const {
  const Lock lock(impl_->mutex);
  const auto found = impl_->tokens.find(target);
  return found == impl_->tokens.end() ? "" : found->second;
}

void VtsTokens::keep(const std::string& target, const std::string& token) {
  const Lock lock(impl_->mutex);
  if (token.empty()) {
    impl_->tokens.erase(target);
  } else {
    impl_->tokens[target] = token;
  }
  files::OutputFile out(impl_->file, 0600);
  out.write(json{{"facet_vts", 1}, {"tokens", impl_->tokens}}.dump(2) + "\n");
  out.commit();
}

const std::string& VtsTokens::fault() const {
  return impl_->fault;
}

struct VtsLink::Impl {
  Impl(BridgeTarget given, VtsTokens& given_tokens, LookUp given_look_up, VtsPatience given_patience)
      : target(std::move(given)),
        tokens(given_tokens),
        look_up(std::move(given_look_up)),
        patience(given_patience) {}

  BridgeTarget target;
  VtsTokens& tokens;
  LookUp look_up;
  VtsPatience patience;
  stream::FileDescriptor wake{::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)};
  std::atomic<bool> stopping = false;
  std::atomic<bool> seeking = false;

  mutable Mutex mutex;
  std::shared_ptr<const VtsParameters> newest FACET_GUARDED_BY(mutex);
  bool fresh FACET_GUARDED_BY(mutex) = false;  ///< not sent yet
  Clock::time_point published_at FACET_GUARDED_BY(mutex);
  VtsLinkStatus status FACET_GUARDED_BY(mutex);

  // The thread's own.
  Clock::time_point sent_at;
  std::string token_fault;                              ///< why it could not be kept
  VtsSession::State reached = VtsSession::State::Over;  ///< by the last visit
  std::jthread thread;

  void run();
  std::string visit();
  std::string converse(stream::WebSocketClient& socket);
  void hear(VtsSession& session, stream::WebSocketClient& socket);
  void tell(const std::string& reason);
  void rest(Clock::duration time);
  void keep_token(const std::string& token);
  void send_frame(VtsSession& session, stream::WebSocketClient& socket);
};

void VtsLink::Impl::tell(const std::string& reason) {
  const Lock lock(mutex);
  status.reason = reason;
}

/// Until it is to stop; frames that come meanwhile are left out.
void VtsLink::Impl::rest(Clock::duration time) {
  const auto until = Clock::now() + time;
  while (!stopping && Clock::now() < until) {
    stream::wait_for_event(wake.get(), until - Clock::now());
  }
}

void VtsLink::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-vts");
  Clock::duration wait = patience.least;
  while (!stopping) {
    reached = VtsSession::State::Over;
    std::string reason;
    try {
      reason = visit();
    } catch (const std::exception& error) {
      reason = error.what();
    }
    if (stopping) {
      return;
    }
    tell(reason);
    if (reached == VtsSession::State::Refused) {
      return;  // a person who said no is not asked again
    }
    rest(wait);
    wait = reached == VtsSession::State::Ready ? patience.least
                                               : std::min<Clock::duration>(2 * wait, patience.most);
  }
}

/// One connection, from its beginning to its end; why it ended.
std::string VtsLink::Impl::visit() {
  SocketAddress address = socket_address(target.address, target.port);
  if (address.length == 0) {
    seeking = true;
    const LookedUp found = look_up(target);
    seeking = false;
    if (found.address.length == 0) {
      return found.trouble;
    }
    address = found.address;
  }
  stream::WebSocketClient socket(target.text(), VtsSession::kMostMessageBytes);
  const auto* name = reinterpret_cast<const sockaddr*>(&address.storage);
  std::string fault = socket.connect(name, address.length);
  const auto deadline = Clock::now() + kConnecting;
  while (fault.empty() && !socket.is_open()) {
    if (stopping || Clock::now() >= deadline) {
      return "does not answer";
    }
    socket.wait(wake.get(), kLook);
    fault = socket.work();
  }
  return fault.empty() ? converse(socket) : fault;
}

std::string VtsLink::Impl::converse(stream::WebSocketClient& socket) {
  VtsSession session(tokens.of(target.text()));
  socket.send(session.begin());
  auto quiet_since = Clock::now();  // while an answer is due
  while (!stopping) {
    tell(session.trouble().empty() ? token_fault : session.trouble());
    socket.wait(wake.get(), kLook);
    if (std::string fault = socket.work(); !fault.empty()) {
      return fault;
    }
    hear(session, socket);
    if (session.state() == VtsSession::State::Over) {
      return session.trouble();
    }
    reached = session.state();
    if (reached == VtsSession::State::Refused) {
      return session.trouble();
    }
    send_frame(session, socket);
    const auto now = Clock::now();
    if (session.heard() || !session.waits()) {
      quiet_since = now;
    } else if (now - quiet_since >= patience.answer) {
      return "does not answer";
    }
  }
  return "";
}

void VtsLink::Impl::hear(VtsSession& session, stream::WebSocketClient& socket) {
  const std::string before = session.token();
  while (const auto message = socket.next()) {
    for (const std::string& answer : session.take(*message)) {
      socket.send(answer);
    }
  }
  if (session.token() != before) {
    keep_token(session.token());
  }
}

void VtsLink::Impl::keep_token(const std::string& token) {
  token_fault.clear();
  try {
    tokens.keep(target.text(), token);
  } catch (const Error& error) {
    token_fault = error.what();  // a person is asked again at the next start
  }
}

void VtsLink::Impl::send_frame(VtsSession& session, stream::WebSocketClient& socket) {
  std::shared_ptr<const VtsParameters> parameters;
  bool is_new = false;
  const auto now = Clock::now();
  {
    const Lock lock(mutex);
    parameters = now - published_at < kGone ? newest : nullptr;
    is_new = std::exchange(fresh, false);
  }
  if (parameters == nullptr || parameters->empty() || (!is_new && now - sent_at < kAgain)) {
    return;
  }
  std::vector<std::string> messages;
  if (socket.is_idle()) {
    messages = session.inject(*parameters);
  }
  for (const std::string& message : messages) {
    socket.send(message);
  }
  const Lock lock(mutex);
  if (!messages.empty()) {
    sent_at = now;
    ++status.frames;
  } else if (session.state() == VtsSession::State::Ready && is_new) {
    ++status.failed;
  }
}

VtsLink::VtsLink(BridgeTarget target, VtsTokens& tokens, LookUp look_up, VtsPatience patience)
    : impl_(std::make_unique<Impl>(std::move(target), tokens, std::move(look_up), patience)) {}

VtsLink::~VtsLink() {
  request_stop();
  stop();
}

void VtsLink::start() {
  impl_->thread = std::jthread([this] { impl_->run(); });
}

void VtsLink::request_stop() {
  impl_->stopping = true;
  stream::signal_event(impl_->wake.get());
}

void VtsLink::stop() {
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
}

bool VtsLink::finished() const {
  return !impl_->seeking;
}

void VtsLink::publish(std::shared_ptr<const VtsParameters> parameters) {
  {
    const Lock lock(impl_->mutex);
    impl_->newest.swap(parameters);
    impl_->fresh = true;
    impl_->published_at = Clock::now();
  }
  stream::signal_event(impl_->wake.get());
}

VtsLinkStatus VtsLink::status() const {
  const Lock lock(impl_->mutex);
  return impl_->status;
}

}  // namespace facet::avatar
