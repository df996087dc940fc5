#include "booth/template_subject.hpp"

#include <algorithm>
#include <utility>

namespace facet::booth {

std::shared_ptr<const mesh::Subject> build_template_subject(const fit::TemplateMesh& surface,
                                                            std::shared_ptr<const mesh::Hierarchy> hierarchy,
                                                            const face::FaceModel& model,
                                                            std::uint32_t count) {
  auto subject = std::make_shared<mesh::Subject>();
  subject->expression_names = model.expression_names;
  const mesh::SparseRows& rows = surface.from_control;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    const auto row = static_cast<std::size_t>(v);
    const auto first = rows.weights.begin() + rows.row_offsets[row];
    const auto heaviest = std::max_element(first, rows.weights.begin() + rows.row_offsets[row + 1]);
    const std::int32_t control = rows.columns[static_cast<std::size_t>(heaviest - rows.weights.begin())];
    subject->regions.push_back(model.regions[static_cast<std::size_t>(control)]);
  }
  subject->hierarchy = std::move(hierarchy);
  subject->id = mesh::subject_id(*subject, count);
  return subject;
}

}  // namespace facet::booth
