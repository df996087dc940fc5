#include "sample_format.hpp"

#include <fmt/format.h>

#include <iterator>
#include <string>

#include "exports/export_sequence.hpp"
#include "files/output_file.hpp"

namespace facet::sample {
namespace {

class PointsWriter final : public exports::SequenceWriter {
 public:
  PointsWriter(const exports::SequenceOptions& options, const exports::SequenceFrame& first)
      : options_(options), triangles_(first.mesh.triangles), out_(options.file) {}

  void add(const exports::SequenceFrame& frame) override {
    exports::require_same_mesh(triangles_, frame, options_.file);
    text_ = fmt::format("frame {} {}\n", frame.sequence, exports::time_s(options_.timeline, frame.sequence));
    for (Eigen::Index vertex = 0; vertex < frame.mesh.vertices_mm.cols(); ++vertex) {
      const auto point_mm = frame.mesh.vertices_mm.col(vertex);
      fmt::format_to(std::back_inserter(text_), "{} {} {}\n", point_mm.x(), point_mm.y(), point_mm.z());
    }
    out_.write(text_);
  }
  void commit() override { out_.commit(); }

 private:
  exports::SequenceOptions options_;
  mesh::Triangles triangles_;
  files::OutputFile out_;
  std::string text_;
};

}  // namespace

std::unique_ptr<exports::SequenceWriter> open_points(const exports::SequenceOptions& options,
                                                     const exports::SequenceFrame& first) {
  return std::make_unique<PointsWriter>(options, first);
}

}  // namespace facet::sample
