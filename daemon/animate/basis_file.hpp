#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <type_traits>
#include <vector>

/// The file NAME.basis beside a take: docs/animation.md is its page.
namespace facet::animate {

inline constexpr std::array<char, 8> kBasisMagic{'F', 'C', 'T', 'K', 'B', 'A', 'S', '\n'};
inline constexpr std::uint32_t kBasisVersion = 1;
inline constexpr int kMaxRank = 256;
inline constexpr int kMaxEyes = 8;

/// What tells one state of a file from another.
struct FileState {
  std::uint64_t bytes = 0;
  std::int64_t modified_ns = 0;
  std::uint64_t inode = 0;
  bool operator==(const FileState&) const = default;
};
/// Throws Error(UnreadableInput) where there is no such file.
FileState state_of(const std::filesystem::path& file);

/// First in the file, little-endian.
struct BasisHeader {
  std::array<char, 8> magic = kBasisMagic;
  std::uint32_t version = kBasisVersion;
  std::uint32_t crc32c = 0;  ///< of all that follows
  FileState take;
  std::uint64_t subject_id = 0;
  std::uint64_t hierarchy_id = 0;
  double frame_period_s = 0;  ///< median
  std::int32_t control_vertex_count = 0;
  std::int32_t finest_vertex_count = 0;
  std::int32_t coarse_rank = 0;
  std::int32_t detail_rank = 0;
  std::int32_t wanted_coarse_rank = 0;  ///< of the options; ranks are lower where there is no more to hold
  std::int32_t wanted_detail_rank = 0;
  std::int32_t eye_count = 0;
  std::int32_t expression_count = 0;
  std::int32_t frame_count = 0;
  std::int32_t left_out = 0;  ///< frames with a mesh that lack the displacements which the others have
  // Measured over every frame and vertex: how far meshes made of coefficients lie from the take's.
  float coarse_max_mm = 0;
  float coarse_rms_mm = 0;
  float detail_max_mm = 0;
  float detail_rms_mm = 0;
  std::int32_t worst_frame = 0;   ///< of coarse_max_mm + detail_max_mm, index in the take
  std::int32_t blinks_known = 0;  ///< 1 where the take's expressions tell blinks
};
static_assert(std::is_trivially_copyable_v<BasisHeader> && sizeof(BasisHeader) == 128);

/// One frame of the take that has a mesh.
struct CapturedFrame {
  std::int64_t index = 0;  ///< in the take
  std::int64_t sequence = 0;
  std::int64_t media_time_ns = 0;
  std::array<float, 12> camera_from_head{};  ///< [3][4] row by row, mm
  float blink = 0;                           ///< 0 lids up to 1 shut; 0 where not known
  std::int32_t follows = 0;                  ///< 1 where it is the next one in time after the frame before it
};
static_assert(std::is_trivially_copyable_v<CapturedFrame> && sizeof(CapturedFrame) == 80);

/// Where the parts of a basis lie; shapes as in TakeBasis.
struct BasisSections {
  const BasisHeader* header = nullptr;
  const CapturedFrame* frames = nullptr;
  const float* coefficients = nullptr;
  const float* coarse = nullptr;
  const float* detail = nullptr;
  const float* folds = nullptr;
  const float* coarse_mean = nullptr;
  const float* detail_mean = nullptr;
  const float* eye_means = nullptr;
  const float* expression_means = nullptr;
  const std::uint8_t* eye_of_vertex = nullptr;
};

/// Of a whole file. Aligned as Eigen adds up: sums have the same bits wherever the memory lies.
using BasisBytes = std::vector<std::byte, Eigen::aligned_allocator<std::byte>>;

/// Finds the parts in the bytes of a file from outside. Throws Error(UnreadableInput), without a file's name,
/// where sizes, checksum or numbers are wrong.
BasisSections basis_sections(std::span<const std::byte> bytes);

/// Bytes of a whole basis file of which header says the sizes; its parts are 0 and are written through
/// mutable_part.
BasisBytes make_basis_bytes(const BasisHeader& header);
/// Sets the checksum, after which basis_sections takes it.
void seal_basis(std::span<std::byte> bytes);
/// The sections of unsealed bytes.
BasisSections unsealed_sections(std::span<const std::byte> bytes);

/// The bytes of a basis file, read into memory; nothing where there is none, it can't be read, or its size is
/// not what its header says. Memory is taken after that. No more than 1 GiB: a basis of the default ranks and
/// half a million vertices has half of it.
std::optional<BasisBytes> read_basis(const std::filesystem::path& file);

}  // namespace facet::animate
