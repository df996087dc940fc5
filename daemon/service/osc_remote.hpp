#pragma once

#include <sys/socket.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "facet/clock.hpp"
#include "service/config.hpp"
#include "service/log.hpp"
#include "service/osc_message.hpp"
#include "service/recording.hpp"
#include "take/recorder.hpp"

namespace facet::service {

/// Takes begun and ended by OSC over UDP, as Epic's Live Link Face app lets itself be commanded: /RecordStart
/// SLATE TAKE, /RecordStop, /Slate, /Take, /OSCSetSendTarget (docs/sound-and-time.md). What is done is
/// confirmed to the sender, or to the port of the same address that it named. Other messages are passed over;
/// what is no OSC, or can't be
/// done, is counted, and told once in ten seconds. Loop only; never waits.
class OscRemote {
 public:
  /// What it works on. All outlive this object.
  struct Desk {
    Recording& recording;
    std::filesystem::path folder;                                          ///< of the takes
    std::function<std::optional<take::TakeRecorderConfig>()> take_config;  ///< nothing: facetd still starts
    std::function<std::string()> timecode_now;                             ///< any thread
  };

  OscRemote(OscConfig config, Desk desk, const Log& log);
  ~OscRemote();
  OscRemote(const OscRemote&) = delete;
  OscRemote& operator=(const OscRemote&) = delete;

  /// Opens the port, where that is due: one that another has is tried again every ten seconds.
  void look_after();
  int fd() const;  ///< to be polled for input; -1 where there is none
  /// Does what has come.
  void serve();

 private:
  struct Door;
  struct Answer;

  void open();
  void take_packet(std::span<const std::byte> packet, const sockaddr_storage& from, socklen_t length);
  void obey(const OscMessage& message, const Answer& answer);
  void begin(const OscMessage& message, const Answer& answer);
  void set_target(const OscMessage& message, const sockaddr_storage& from, socklen_t length);
  /// On the errands' thread: what `work` gives is the answer; what it throws is told.
  void ask(const std::string& what, const Answer& answer, std::function<OscMessage()> work);

  const OscConfig config_;
  const Desk desk_;
  const Log& log_;
  std::shared_ptr<Door> door_;  ///< shared with answers that are under way
  std::string slate_;
  /// The next take's. Once a take was asked for, the errands' thread alone reads it and counts it up, in the
  /// order of the messages; another number that is said is another counter.
  std::shared_ptr<std::int32_t> take_number_ = std::make_shared<std::int32_t>(1);
  std::optional<std::uint16_t> target_port_;  ///< asked for, of target_
  sockaddr_storage target_{};
  Clock::time_point open_due_;
  std::string open_fault_;
};

/// The text with "_" in the place of every byte that is no UTF-8.
std::string as_utf8(std::string_view text);

/// The name of a take of a slate, "SLATE_3": what no name can have is replaced. slate: of any length and any
/// bytes.
std::string slate_take_name(const std::string& slate, std::int32_t number);

}  // namespace facet::service
