#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/value_mapping.hpp"

namespace facet::avatar {

/// A tracking parameter of VTube Studio's and its value now.
struct VtsParameter {
  std::string id;
  float value = 0;
};
using VtsParameters = std::vector<VtsParameter>;

/// What VTube Studio gets of a frame: its own parameters (docs/bridges.md lists them), with `arkit` ARKit's
/// 52 as custom ones ("JawOpen"), and those of `chosen`. Empty without a face that has an expression.
VtsParameters vts_parameters(const FaceState& state, const MappedValues& chosen, bool arkit);

/// A conversation with VTube Studio's API for plug-ins (https://github.com/DenchiSoft/VTubeStudio, version
/// 1.0), without its socket: permission that a person gives once, the token that stands for it, custom
/// parameters created as they are needed, frames injected. One thread.
class VtsSession {
 public:
  static constexpr std::size_t kMostMessageBytes = 1U << 16;
  /// So many frames may be unanswered; the next ones are left out.
  static constexpr std::size_t kMostUnanswered = 8;

  enum class State {
    Asking,          ///< a person is asked whether facetd may; for as long as they take
    Authenticating,  ///< the token is shown
    Ready,           ///< frames are taken
    Refused,         ///< the person said no; they are not asked again
    Over,            ///< the connection is of no use any more
  };

  /// token: of an earlier session; empty: none.
  explicit VtsSession(std::string token) : token_(std::move(token)) {}

  /// The first request, once the connection is open.
  std::string begin();
  /// Takes what VTube Studio said; returns what is to be sent now. Never throws for anything that it may be.
  std::vector<std::string> take(std::string_view message);
  /// What is to be sent of a frame: nothing unless Ready.
  std::vector<std::string> inject(const VtsParameters& parameters);

  State state() const { return state_; }
  /// Empty, or what permission stands for, to be kept.
  const std::string& token() const { return token_; }
  /// What it said of what went wrong last, or what is waited for; empty where all is well.
  const std::string& trouble() const { return trouble_.empty() ? custom_trouble_ : trouble_; }
  /// An answer is due that no person is needed for.
  bool waits() const { return state_ == State::Authenticating || unanswered_ > 0; }
  /// Whether something was taken since this was asked last.
  bool heard() { return std::exchange(heard_, false); }

 private:
  enum class Custom { Asked, There, Refused };

  std::string ask_for_token();
  std::string show_token();
  void take_error(const std::string& id, int number, const std::string& text);
  void end(std::string why);

  State state_ = State::Over;
  std::string token_;
  std::string trouble_;
  std::string custom_trouble_;  ///< of a parameter that could not be created, for as long as it lasts
  std::size_t unanswered_ = 0;
  bool heard_ = false;
  std::map<std::string, Custom> customs_;
};

}  // namespace facet::avatar
