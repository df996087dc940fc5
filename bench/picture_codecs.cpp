#include "picture_codecs.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <utility>

#include "facet/error.hpp"
#include "mesh/mesh_frame.hpp"
#include "stream/encoder.hpp"
#include "stream/pixel_packing.hpp"
#include "take/checksum.hpp"
#include "take/picture_records.hpp"
#include "take/take_file.hpp"

namespace facet::bench {
namespace {

constexpr int kRounds = 5;

/// A picture without alpha, grey in one channel.
struct Packed {
  std::size_t rows = 0;
  std::size_t row_bytes = 0;
  std::size_t channels = 0;
  std::vector<std::uint8_t> bytes;
};

/// Processor time of this thread, s: the same on a busy machine.
double processor_s() {
  timespec now{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + static_cast<double>(now.tv_nsec) * 1e-9;
}

/// The shortest time of `work`, s.
double best_of_rounds(const std::function<void()>& work) {
  double best_s = 1e9;
  for (int round = 0; round < kRounds; ++round) {
    const double start_s = processor_s();
    work();
    best_s = std::min(best_s, processor_s() - start_s);
  }
  return best_s;
}

struct Above {
  static constexpr const char* kName = "to the row above";
  static int predict(int above, int /*left*/, int /*above_left*/) { return above; }
};
struct Mean {
  static constexpr const char* kName = "to the mean of above and left";
  static int predict(int above, int left, int /*above_left*/) { return (above + left + 1) / 2; }
};
struct Median {
  static constexpr const char* kName = "median of three (JPEG-LS)";
  static int predict(int above, int left, int above_left) {
    return std::clamp(above + left - above_left, std::min(above, left), std::max(above, left));
  }
};
struct None {
  static constexpr const char* kName = "none";
  static int predict(int /*above*/, int /*left*/, int /*above_left*/) { return 0; }
};

/// Differences to what is predicted (Sign -1), or the pixels from them (+1); the first row and pixel as if
/// zeros stood around them.
template <typename Predictor, int Sign>
void transform(const Packed& in, std::vector<std::uint8_t>& out) {
  out.resize(in.bytes.size());
  const std::uint8_t* pixels = Sign < 0 ? in.bytes.data() : out.data();
  for (std::size_t y = 0; y < in.rows; ++y) {
    const std::size_t row = y * in.row_bytes;
    for (std::size_t x = 0; x < in.channels; ++x) {
      const int above = y > 0 ? pixels[row - in.row_bytes + x] : 0;
      out[row + x] = static_cast<std::uint8_t>(in.bytes[row + x] + Sign * Predictor::predict(above, 0, 0));
    }
    if (y == 0) {
      for (std::size_t x = in.channels; x < in.row_bytes; ++x) {
        out[x] =
            static_cast<std::uint8_t>(in.bytes[x] + Sign * Predictor::predict(0, pixels[x - in.channels], 0));
      }
      continue;
    }
    const std::uint8_t* above = pixels + row - in.row_bytes;
    for (std::size_t x = in.channels; x < in.row_bytes; ++x) {
      out[row + x] = static_cast<std::uint8_t>(
          in.bytes[row + x] +
          Sign * Predictor::predict(above[x], pixels[row + x - in.channels], above[x - in.channels]));
    }
  }
}

struct Setting {
  const char* name;
  int level;
  int hash_log;  ///< 0: the level's
  int shortest_match;
};

template <typename Predictor>
void measure(const std::vector<Packed>& pictures, const Setting& setting) {
  const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> packer(ZSTD_createCCtx(), &ZSTD_freeCCtx);
  const std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)> unpacker(ZSTD_createDCtx(), &ZSTD_freeDCtx);
  ZSTD_CCtx_setParameter(packer.get(), ZSTD_c_compressionLevel, setting.level);
  ZSTD_CCtx_setParameter(packer.get(), ZSTD_c_hashLog, setting.hash_log);
  ZSTD_CCtx_setParameter(packer.get(), ZSTD_c_minMatch, setting.shortest_match);
  std::size_t raw = 0;
  std::size_t stored = 0;
  double pack_s = 0;
  double unpack_s = 0;
  Packed differences;
  std::vector<std::uint8_t> pixels;
  for (const Packed& picture : pictures) {
    std::vector<std::uint8_t> bytes(ZSTD_compressBound(picture.bytes.size()));
    std::size_t size = 0;
    differences = picture;
    pack_s += best_of_rounds([&] {
      transform<Predictor, -1>(picture, differences.bytes);
      size = ZSTD_compress2(packer.get(), bytes.data(), bytes.size(), differences.bytes.data(),
                            differences.bytes.size());
    });
    unpack_s += best_of_rounds([&] {
      ZSTD_decompressDCtx(unpacker.get(), differences.bytes.data(), differences.bytes.size(), bytes.data(),
                          size);
      transform<Predictor, 1>(differences, pixels);
    });
    if (pixels != picture.bytes) {
      throw Error(ErrorKind::Internal, fmt::format("'{}' is not lossless", Predictor::kName));
    }
    raw += picture.bytes.size();
    stored += size;
  }
  const double megabytes = static_cast<double>(raw) / 1e6;
  fmt::print("| {} | {} | {:.1f} % | {:.0f} | {:.0f} |\n", Predictor::kName, setting.name,
             100 * static_cast<double>(stored) / static_cast<double>(raw), megabytes / pack_s,
             megabytes / unpack_s);
}

}  // namespace

void measure_codecs(const std::vector<FrameSet>& sets) {
  std::vector<Packed> pictures;
  for (const FrameSet& set : sets) {
    for (const Frame& frame : set.frames) {
      Packed packed;
      packed.channels = stream::channel_count(frame);
      packed.rows = static_cast<std::size_t>(frame.height_px);
      packed.row_bytes = packed.channels * static_cast<std::size_t>(frame.width_px);
      packed.bytes.resize(packed.rows * packed.row_bytes);
      stream::pack_pixels(frame, packed.channels, packed.bytes.data());
      pictures.push_back(std::move(packed));
    }
  }
  constexpr Setting kSmallTable{"zstd 1, 2^8 matches of 7 bytes", 1, 8, 7};
  constexpr std::array kOthers = {Setting{"zstd 1", 1, 0, 0}, Setting{"zstd 3", 3, 0, 0},
                                  Setting{"zstd -1", -1, 0, 0}};
  fmt::print("\n| differences | packed by | bytes | packs, MB/s | unpacks, MB/s |\n|---|---|---|---|---|\n");
  measure<Above>(pictures, kSmallTable);
  for (const Setting& setting : kOthers) {
    measure<Above>(pictures, setting);
  }
  measure<Mean>(pictures, kSmallTable);
  measure<Median>(pictures, kSmallTable);
  measure<None>(pictures, kSmallTable);
  measure<None>(pictures, kOthers[0]);
}

void measure_steps(const std::vector<FrameSet>& sets) {
  const auto print = [&](const char* what, double seconds) {
    fmt::print("| {} | {:.2f} |\n", what, 1e3 * seconds / static_cast<double>(sets.size()));
  };
  std::vector<std::uint8_t> bytes;
  fmt::print("\n| step, one thread | ms a set |\n|---|---|\n");
  print("grey or colour, packed", best_of_rounds([&] {
          for (const FrameSet& set : sets) {
            for (const Frame& frame : set.frames) {
              bytes.resize(3 * static_cast<std::size_t>(frame.width_px) *
                           static_cast<std::size_t>(frame.height_px));
              stream::pack_pixels(frame, stream::channel_count(frame), bytes.data());
            }
          }
        }));
  take::PictureWriter writer;
  std::vector<std::vector<std::uint8_t>> records(sets.size());
  print("records: packed, differences, zstd, checksum", best_of_rounds([&] {
          for (std::size_t i = 0; i < sets.size(); ++i) {
            records[i].clear();
            writer.append(sets[i], i, records[i]);
          }
        }));
  std::uint32_t sums = 0;
  print("checksum alone", best_of_rounds([&] {
          for (const auto& record : records) {
            sums ^= take::crc32c(record);
          }
        }));
  take::PictureReader reader;
  std::vector<FrameSet> described = sets;
  print("records read", best_of_rounds([&] {
          for (std::size_t i = 0; i < sets.size(); ++i) {
            for (Frame& frame : described[i].frames) {
              frame.pixels = nullptr;
            }
            reader.read(records[i], i, described[i]);
          }
        }));
  stream::Encoder encoder;
  take::BlobCompressor compressor(1);
  std::size_t message_bytes = sums & 1U;  // so that nothing above is left out
  print("format version 1: message with pixels, zstd 1", best_of_rounds([&] {
          for (const FrameSet& set : sets) {
            mesh::MeshFrame frame;
            frame.control_vertices_mm.resize(3, 0);
            frame.images = std::make_shared<const FrameSet>(set);
            message_bytes +=
                compressor.compress(encoder.frame(frame, stream::Profile::Displacements, {true})).size();
          }
        }));
  if (message_bytes == 0) {
    throw Error(ErrorKind::Internal, "nothing was encoded");
  }
}

}  // namespace facet::bench
