#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mesh/mesh_frame.hpp"
#include "take/notes.hpp"
#include "take/take_time.hpp"

namespace facet::take {

/// A file of a take's pictures.
struct TakeSegment {
  std::int64_t number = 0;
  std::filesystem::path file;
  std::int64_t first_frame = 0;  ///< FrameEntry::index
  std::int64_t last_frame = 0;
  std::int64_t frame_count = 0;  ///< with pictures in it
  std::uint64_t bytes = 0;       ///< of these frames' pictures
  std::string fault;  ///< empty, or why some or all of it can't be read: missing, another take's, cut off
};

/// What a take says of itself.
struct TakeInfo {
  std::filesystem::path file;
  std::int32_t format_version = 0;
  std::string source;  ///< 4 KiB at most; the texts below 1 KiB, cut
  std::string software;
  std::string created_utc;  ///< ISO 8601
  bool closed = false;      ///< false: its recorder was killed or failed, or still records
  std::string end_reason;   ///< empty, or why the recording ended by itself
  TakeNotes notes;          ///< what people wrote to it
  std::string cut_from;     ///< empty, or of which take, and which frames of it, it is a copy
  TakeTimecode timecode;    ///< of its frames, by their timestamps
  TakeSound sound;          ///< beside it
  std::uint64_t dropped = 0;
  std::int64_t frame_count = 0;
  std::int64_t mesh_frame_count = 0;
  std::int64_t first_timestamp_ns = 0;  ///< of the first and last frame
  std::int64_t last_timestamp_ns = 0;
  /// From the first frame to the last as the source has them, whatever time it took to make them.
  double duration_s = 0;
  std::int64_t subject_count = 0;
  std::vector<TakeSegment> segments;  ///< of the pictures, in their order; none in format version 1
  std::uint64_t picture_bytes = 0;    ///< of the segments' files
  std::uint64_t file_bytes = 0;       ///< with the segments
};

/// What a list of takes shows, in a time that hardly grows with the take: its meshes are as many as its
/// recorder says, and the segments are not looked into (`segments` is empty). A take that is not closed, or
/// of an older recorder, has its index read once. Texts but the source are cut at 1 KiB. Any thread. Throws
/// as TakeReader does.
TakeInfo listed_info(const std::filesystem::path& file);

/// What the index knows of a frame without decoding it.
struct FrameEntry {
  std::int64_t index = 0;
  std::uint64_t sequence = 0;
  std::int64_t timestamp_ns = 0;
  std::int64_t media_time_ns = 0;
  mesh::TrackingState state = mesh::TrackingState::Searching;
  bool has_mesh = false;
};

/// Whether a frame's pictures are wanted with their pixels.
enum class Pictures {
  Decoded,
  Described,  ///< their sizes and times alone, without a look at the segments (format version 1: with pixels)
};

/// Reads a take, also while it is being recorded or after its recorder was killed. Everything in the file is
/// checked before use. One thread. Throws Error(UnreadableInput) naming the file and what is wrong: missing,
/// not a take, made by a newer version, damaged (with the frame, and the segment where it is one that is
/// damaged or missing), and Error(Unavailable) where another program holds it locked for longer than two
/// seconds, or it can't be opened just now. Frames that are sound stay readable.
class TakeReader {
 public:
  explicit TakeReader(const std::filesystem::path& file);
  ~TakeReader();
  TakeReader(TakeReader&&) noexcept;
  TakeReader& operator=(TakeReader&&) noexcept;

  const TakeInfo& info() const;
  /// Frames are numbered 0 to frame_count() - 1 without gaps; the count is that of the time of opening.
  std::int64_t frame_count() const;

  FrameEntry entry(std::int64_t index);
  /// Subjects and albedos are cached, the last two and the last one of them: frames that share one share the
  /// object as long as anybody has it.
  std::shared_ptr<const mesh::MeshFrame> frame(std::int64_t index, Pictures pictures = Pictures::Decoded);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::take
