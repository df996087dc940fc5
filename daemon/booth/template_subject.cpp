#include "booth/template_subject.hpp"

#include <algorithm>
#include <utility>

namespace facet::booth {
namespace {

/// The control vertex of the model that a vertex of the template hangs on most.
std::size_t nearest_control(const mesh::SparseRows& rows, std::int32_t vertex) {
  const auto row = static_cast<std::size_t>(vertex);
  const auto first = rows.weights.begin() + rows.row_offsets[row];
  const auto heaviest = std::max_element(first, rows.weights.begin() + rows.row_offsets[row + 1]);
  return static_cast<std::size_t>(rows.columns[static_cast<std::size_t>(heaviest - rows.weights.begin())]);
}

}  // namespace

std::shared_ptr<const mesh::Subject> build_template_subject(const fit::TemplateMesh& surface,
                                                            std::shared_ptr<const mesh::Hierarchy> hierarchy,
                                                            const face::FaceModel& model,
                                                            std::uint32_t count) {
  auto subject = std::make_shared<mesh::Subject>();
  subject->expression_names = model.expression_names;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    subject->regions.push_back(model.regions[nearest_control(surface.from_control, v)]);
  }
  subject->hierarchy = std::move(hierarchy);
  subject->id = mesh::subject_id(*subject, count);
  return subject;
}

std::vector<face::FacePart> template_parts(const fit::TemplateMesh& surface, const face::FaceModel& model) {
  const std::vector<face::FacePart> control = face::control_parts(model);
  std::vector<face::FacePart> parts;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    parts.push_back(control[nearest_control(surface.from_control, v)]);
  }
  return parts;
}

}  // namespace facet::booth
