#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace facet::service {

/// The control protocol: JSON-RPC 2.0, one message a line (docs/control-protocol.md).

/// A request line longer than this is refused and its client dropped, bytes.
inline constexpr std::size_t kMaxRequestBytes = 1U << 20;
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
  std::int32_t pid = 0;
  std::uint32_t uid = 0;
  bool may_command = false;  ///< may call methods that change something
};

/// What a member of "params" may be.
struct ControlParam {
  enum class Type { Any, Text, Number, Flag };

  std::string name;
  Type type = Type::Any;  ///< Any: the method's own to check
  bool required = false;
};

struct ControlMethod {
  bool changes_something = true;  ///< callers need Caller::may_command
  std::vector<ControlParam> params;
  /// Gets the params object (empty where none were sent), which is as `params` says, and returns the result.
  /// Throws facet::Error.
  std::function<nlohmann::json(const nlohmann::json& params)> call;
};
using ControlMethods = std::map<std::string, ControlMethod, std::less<>>;

/// Answers one line: the response without its newline, empty where the request was a notification. Never
/// throws for anything that a client may send.
std::string answer_request(const ControlMethods& methods, std::string_view line, const Caller& caller);

/// A response that says only what went wrong, for requests that can't be read at all.
std::string error_response(int code, const std::string& message);

}  // namespace facet::service
