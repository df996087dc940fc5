#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace facet::service {

class Errands;

/// The control protocol: JSON-RPC 2.0, one message a line (docs/control-protocol.md).

/// A request line longer than this is refused and its client dropped, bytes.
inline constexpr std::size_t kMaxRequestBytes = 1U << 20;
/// The same for callers who may only look: what can be looked at needs few words, and they take the daemon's
/// time.
inline constexpr std::size_t kMaxLookBytes = 16U << 10;
/// A longer answer to a request or a batch becomes an error, bytes.
inline constexpr std::size_t kMaxAnswerBytes = 4U << 20;
/// More requests than this in one batch are refused.
inline constexpr std::size_t kMaxBatch = 32;

/// Error codes of JSON-RPC 2.0 and ours. A facet::Error becomes kServerErrorBase - its kind, so that a
/// command-line program can exit with that kind.
enum ControlErrorCode : int {
  kParseError = -32700,
  kInvalidRequest = -32600,
  kMethodNotFound = -32601,
  kInvalidParams = -32602,
  kServerErrorBase = -32000,
  kPermissionDenied = -32020,
};

/// Who sent a request, as the kernel says.
struct Caller {
  std::int32_t pid = 0;  ///< 0 over the web, as is uid: the kernel knows nobody there
  std::uint32_t uid = 0;
  bool may_command = false;  ///< may call methods that change something
  bool over_web = false;     ///< by the page's WebSocket: the token decides, not the user
};

/// What a member of "params" may be.
struct ControlParam {
  enum class Type { Any, Text, Number, Flag };

  std::string name;
  Type type = Type::Any;  ///< Any: the method's own to check
  bool required = false;
};

/// What a method answers: its result, or the work that makes it, which an errands' thread does while the loop
/// goes on.
struct ControlAnswer {
  using Work = std::function<std::string()>;  ///< the result as JSON text

  ControlAnswer(nlohmann::json given) : result(std::move(given)) {}  // NOLINT: a result is an answer
  /// The errands must outlive the work. Work throws facet::Error, and must not touch what is the loop's own.
  ControlAnswer(Errands& whose, Work given) : errands(&whose), work(std::move(given)) {}

  nlohmann::json result;
  Errands* errands = nullptr;  ///< null: `result` is there
  Work work;
};

struct ControlMethod {
  bool changes_something = true;  ///< callers need Caller::may_command
  std::vector<ControlParam> params;
  /// Gets the params object (empty where none were sent), which is as `params` says. Called on the loop: it
  /// may look at files no more than it may wait. Throws facet::Error.
  std::function<ControlAnswer(const nlohmann::json& params)> call;
};
using ControlMethods = std::map<std::string, ControlMethod, std::less<>>;

/// Work for an errands' thread; returns the response, "" for a notification.
struct ControlJob {
  Errands* errands;
  bool notification;
  std::function<std::string()> run;
};

/// What is asked in one line or message, a request or a batch of them, and answered one request at a time.
class ControlExchange {
 public:
  /// Reads the line. Never throws for anything that a client may send.
  ControlExchange(std::string_view line, const Caller& caller);

  /// All is answered.
  bool done() const { return next_ >= requests_.size(); }
  std::size_t request_count() const { return requests_.size(); }
  /// Takes up the next request: answers it or returns the work that does, whose outcome answer() must get
  /// before the next step.
  std::optional<ControlJob> step(const ControlMethods& methods);
  void answer(std::string response);
  /// Of the answers so far.
  std::size_t response_bytes() const { return text_.size(); }
  /// What is to be sent, without its newline; empty where nothing is.
  std::string response() &&;

 private:
  Caller caller_;
  bool batch_ = false;
  std::vector<nlohmann::json> requests_;
  std::size_t next_ = 0;
  std::string text_;  ///< the responses so far; of a batch as its list begins
};

/// As JSON; text that is not UTF-8 (paths need not be) has its bytes replaced.
std::string to_text(const nlohmann::json& message);

/// Answers one line with all the work that it takes, on this thread: for those who have no loop that waits.
std::string answer_request(const ControlMethods& methods, std::string_view line, const Caller& caller);

/// A response that says only what went wrong, for requests that can't be read at all.
std::string error_response(int code, const std::string& message);

}  // namespace facet::service
