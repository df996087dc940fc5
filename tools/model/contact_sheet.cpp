#include "model/contact_sheet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <vector>

#include "model/portrait.hpp"

namespace facet::model {
namespace {

constexpr std::array<std::uint8_t, 3> kPaper = {24, 25, 28};
constexpr std::array<std::uint8_t, 3> kInk = {235, 235, 225};
constexpr float kSideYawRad = 0.8F;
constexpr float kIdentitySigmas = 2.0F;

/// Two pictures side by side under one label.
struct Tile {
  std::string label;
  std::vector<float> first_identity;
  std::vector<float> second_identity;
  std::vector<float> expression;
  bool second_from_side = false;
};

std::vector<float> one_weight(int count, int at, float value) {
  std::vector<float> weights(static_cast<std::size_t>(count), 0.0F);
  weights[static_cast<std::size_t>(at)] = value;
  return weights;
}

}  // namespace

render::Picture contact_sheet(const face::FaceModel& model, const SheetOptions& options,
                              const std::function<void(int done, int total)>& progress) {
  std::vector<Tile> tiles = {{model.name, {}, {}, {}, true}};
  for (int i = 0; options.identities && i < model.identity_count(); ++i) {
    tiles.push_back({fmt::format("identity {}: {:+.0f} {:+.0f} sigma", i, -kIdentitySigmas, kIdentitySigmas),
                     one_weight(model.identity_count(), i, -kIdentitySigmas),
                     one_weight(model.identity_count(), i, kIdentitySigmas),
                     {},
                     false});
  }
  for (int e = 0; options.expressions && e < model.expression_count(); ++e) {
    tiles.push_back({model.expression_names[static_cast<std::size_t>(e)],
                     {},
                     {},
                     one_weight(model.expression_count(), e, 1),
                     true});
  }

  const PortraitRenderer renderer(model);
  const int per_row = std::max(1, options.columns / 2);
  const int rows = (static_cast<int>(tiles.size()) + per_row - 1) / per_row;
  const int label_px = render::text_size_px("X").y() + 4;
  const int row_px = options.tile_px + label_px;
  render::Picture sheet = render::plain_picture(2 * per_row * options.tile_px, rows * row_px, kPaper);
  mesh::Vertices vertices_mm;
  for (std::size_t t = 0; t < tiles.size(); ++t) {
    const Tile& tile = tiles[t];
    const int x_px = static_cast<int>(t) % per_row * 2 * options.tile_px;
    const int y_px = static_cast<int>(t) / per_row * row_px;
    View view;
    view.size_px = options.tile_px;
    model.evaluate(tile.first_identity, tile.expression, vertices_mm);
    const Style style = tile.second_from_side && tile.expression.empty() ? Style::Lifelike : Style::Clay;
    render::paste(sheet, renderer.render(vertices_mm, view, style), x_px, y_px + label_px);
    model.evaluate(tile.second_identity, tile.expression, vertices_mm);
    view.yaw_rad = tile.second_from_side ? kSideYawRad : 0;
    render::paste(sheet, renderer.render(vertices_mm, view, style), x_px + options.tile_px, y_px + label_px);
    render::draw_text(sheet, x_px + 3, y_px + 2, tile.label, kInk);
    progress(static_cast<int>(t) + 1, static_cast<int>(tiles.size()));
  }
  return sheet;
}

}  // namespace facet::model
