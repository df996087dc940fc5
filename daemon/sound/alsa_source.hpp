#pragma once

#include <memory>
#include <string>

#include "sound/sound_source.hpp"

namespace facet::sound {

/// An input of ALSA (the kernel's sound cards, and what its configuration puts before them, PipeWire too), by
/// the name that ALSA has for it: "hw:1,0", "plughw:CARD=USB,DEV=0", "default". What it can't do of the
/// format is why it does not open.
class AlsaSource final : public SoundSource {
 public:
  AlsaSource(std::string device, int rate_hz, int channels);
  ~AlsaSource() override;

  SoundFormat open() override;
  SoundEvent read(SoundBlock& block) override;
  std::string reason() const override;
  void close() override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::sound
