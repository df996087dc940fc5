#include <bit>

#include "exports/export_sequence.hpp"

namespace facet::exports {
namespace {

/// Four bytes as MDD has them, most significant first.
template <typename T>
std::uint32_t big_endian(T value) {
  return __builtin_bswap32(std::bit_cast<std::uint32_t>(value));
}

/// MDD (LightWave's Motion Designer): counts of samples and points, the samples' times in seconds, the
/// samples.
class MddWriter final : public SequenceWriter {
 public:
  MddWriter(const SequenceOptions& options, const SequenceFrame& first)
      : cache_(options, first), out_(options.file) {
    words_ = {big_endian(cache_.sample_count()), big_endian(cache_.point_count())};
    const std::uint64_t start = options.timeline.sequences.front();
    for (std::int32_t sample = 0; sample < cache_.sample_count(); ++sample) {
      words_.push_back(big_endian(
          static_cast<float>(time_s(options.timeline, start + static_cast<std::uint64_t>(sample)))));
    }
    out_.write(std::as_bytes(std::span(words_)));
  }

  void add(const SequenceFrame& frame) override {
    cache_.add(frame, [this](const mesh::Vertices& points) {
      words_.clear();
      for (Eigen::Index i = 0; i < points.size(); ++i) {
        words_.push_back(big_endian(points.data()[i]));
      }
      out_.write(std::as_bytes(std::span(words_)));
    });
  }
  void commit() override { cache_.commit(out_); }

 private:
  VertexCache cache_;
  files::OutputFile out_;
  std::vector<std::uint32_t> words_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_mdd(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<MddWriter>(options, first);
}

}  // namespace facet::exports
