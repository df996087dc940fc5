#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "animate/animation.hpp"
#include "animate/face_ik.hpp"
#include "animate/take_basis.hpp"
#include "facet/clock.hpp"
#include "mesh/mesh_frame.hpp"
#include "studio/studio.hpp"
#include "take/reader.hpp"

namespace facet::studio {

/// What a controller may look at while the thread works: immutable, or safe for any thread.
struct Faces {
  std::shared_ptr<const animate::TakeBasis> basis;
  std::shared_ptr<animate::FaceIk> ik;  ///< solve: the thread only; check: any
  mesh::Vertices rest_mm;
  std::vector<std::pair<std::string, std::int32_t>> places;
};

/// The open take: its meshes over time, the faces that are made of it, and how far it is played. The studio's
/// thread only.
struct Session {
  struct MeshEntry {
    std::int64_t index = 0;  ///< in the take
    double time_s = 0;       ///< from the first
    std::uint64_t sequence = 0;
  };

  /// name: for people. posing: for control points and keys too. progress: as animate::TakeBasis::open. Throws
  /// Error where the take can't be opened.
  Session(std::filesystem::path file, const std::string& name, bool posing,
          const std::function<bool(std::int64_t done, std::int64_t total)>& progress);

  double duration_s(Shown what) const;
  /// The face of the keys at a time.
  mesh::MeshFrame animated(double time_s) const;
  /// The newest mesh of a time.
  std::size_t entry_at(double time_s) const;

  bool is_animated(const std::string& keys) const { return animation && animated_keys == keys; }
  /// Makes the animation of these keys; returns warnings. Throws what animate::Animation::of_keys throws,
  /// also where `go_on` says that it is not wanted any more.
  std::vector<std::string> make_animation(std::string text, const std::function<bool()>& go_on);

  std::int64_t animation_frames() const;
  /// Writes the animation as a take. progress: frames so far; false breaks it off, and nothing stays. Throws
  /// Error.
  void write_animation(const std::filesystem::path& to, const std::string& software,
                       const std::function<bool(std::int64_t written)>& progress) const;

  /// Makes the frame the one that is on the stream. asked: when it was. Throws Error(Internal) where a number
  /// of it is not finite.
  void keep(mesh::MeshFrame frame, std::optional<Clock::time_point> asked, Clock::time_point now);

  void play(Shown what, double from_s, bool begin_again, Clock::time_point now);
  /// Where the play is; from the beginning again where it loops.
  double advance(Clock::time_point now);
  /// Until the play's next frame.
  Clock::duration step_after(double time_s) const;

  std::filesystem::path file;
  animate::FileState file_state;
  std::optional<take::TakeReader> reader;
  std::vector<MeshEntry> meshes;
  std::shared_ptr<const Faces> faces;  ///< null where it is open for replay alone
  animate::Pose pose;
  mesh::MeshFrame blank;
  std::string stored_keys;    ///< beside the take when it was opened; empty: none
  std::string keys_fault;     ///< why it is open without them
  std::string animated_keys;  ///< what `animation` was made of
  std::optional<animate::Animation> animation;
  double keys_rate_hz = 30;
  std::shared_ptr<const mesh::MeshFrame> last;  ///< on the stream
  std::uint64_t published = 0;
  // While playing.
  std::optional<Shown> playing;
  bool loop = false;
  double played_from_s = 0;
  Clock::time_point playing_since;
  Clock::time_point next_due;
  Clock::time_point repeat_due;
  Clock::time_point check_due;
};

}  // namespace facet::studio
