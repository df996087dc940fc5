#include <bit>
#include <cstring>

#include "exports/export_sequence.hpp"

namespace facet::exports {
namespace {

static_assert(std::endian::native == std::endian::little);

/// The head of a PC2 file (Pointcache 2, of 3ds Max).
struct Pc2Head {
  char magic[12] = {'P', 'O', 'I', 'N', 'T', 'C', 'A', 'C', 'H', 'E', '2', '\0'};
  std::int32_t version = 1;
  std::int32_t point_count = 0;
  float start_frame = 0;
  float frames_per_sample = 1;
  std::int32_t sample_count = 0;
};
static_assert(sizeof(Pc2Head) == 32);

class Pc2Writer final : public SequenceWriter {
 public:
  Pc2Writer(const SequenceOptions& options, const SequenceFrame& first)
      : cache_(options, first), out_(options.file) {
    Pc2Head head;
    head.point_count = cache_.point_count();
    head.start_frame = static_cast<float>(options.timeline.sequences.front());
    head.sample_count = cache_.sample_count();
    out_.write(std::as_bytes(std::span(&head, 1)));
  }

  void add(const SequenceFrame& frame) override {
    cache_.add(frame, [this](const mesh::Vertices& points) {
      out_.write(std::as_bytes(std::span(points.data(), static_cast<std::size_t>(points.size()))));
    });
  }
  void commit() override { cache_.commit(out_); }

 private:
  VertexCache cache_;
  files::OutputFile out_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_pc2(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<Pc2Writer>(options, first);
}

}  // namespace facet::exports
