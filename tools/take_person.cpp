#include "take_person.hpp"

#include <fmt/format.h>

#include <filesystem>

#include "face/person_model.hpp"
#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::tools {

face::ExpressionBasis person_shapes(const mesh::MeshFrame& frame, const std::string& take,
                                    const std::string& model_file) {
  const mesh::Subject& subject = *frame.subject;
  if (subject.expression_names.empty()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("the frames of '{}' have no expressions (a booth's template fit has none)", take));
  }
  const std::filesystem::path file =
      model_file.empty() ? service::default_config().pipeline.model_file : std::filesystem::path(model_file);
  const face::FaceModel model = face::FaceModel::load(file);
  const auto mismatch = [&](const std::string& what) {
    return Error(ErrorKind::Usage,
                 fmt::format("'{}' was not made with the model {} ({}): give the one with --model", take,
                             file.string(), what));
  };
  if (model.expression_names != subject.expression_names ||
      model.vertex_count() != subject.hierarchy->control_vertex_count) {
    throw mismatch("its expressions or vertices are others");
  }
  face::ExpressionBasis basis = face::expressions_of(model, subject);
  if (basis.deltas_mm.size() != subject.expression_names.size()) {
    throw mismatch("it has another number of identities");
  }
  mesh::Vertices rebuilt_mm;
  basis.evaluate(mesh::shape_weights(frame), rebuilt_mm);
  const float difference_mm = (rebuilt_mm - frame.control_vertices_mm).colwise().norm().maxCoeff();
  // The take's vertices are rounded to a hundredth of a millimetre.
  constexpr float kMostDifference_mm = 0.1F;
  if (!(difference_mm <= kMostDifference_mm)) {
    throw mismatch(fmt::format("frame {} differs from it by {:.2f} mm", frame.sequence, difference_mm));
  }
  return basis;
}

}  // namespace facet::tools
