#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "take/take_time.hpp"

namespace facet::sound {

/// A frame of linear timecode (LTC) as it was heard.
struct LtcFrame {
  std::int64_t first_sample = 0;  ///< of the sound, where it begins
  std::int64_t end_sample = 0;    ///< behind its last
  take::TimecodeLabel label;
  bool drop = false;       ///< its drop-frame flag
  bool backwards = false;  ///< the tape runs so
};

/// Finds linear timecode in sound, by libltc: at any level, within some per cent of its speed, backwards too.
/// Where a frame begins is right to three samples. One thread.
class LtcReader {
 public:
  explicit LtcReader(int rate_hz);
  ~LtcReader();
  LtcReader(const LtcReader&) = delete;
  LtcReader& operator=(const LtcReader&) = delete;

  /// samples     of the timecode's channel, 24 bits
  /// first       the number of the first of them, rising; what is left out counts as lost
  /// found       gets what was found whole by now
  void read(std::span<const std::int32_t> samples, std::int64_t first, std::vector<LtcFrame>& found);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::sound
