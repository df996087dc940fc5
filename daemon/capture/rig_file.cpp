#include "capture/rig_file.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <initializer_list>
#include <iterator>
#include <optional>

#include "facet/error.hpp"
#include "facet/frame_set.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "files/toml_section.hpp"

namespace facet::capture {
namespace {

using files::TomlSection;

// What lies beyond these bounds is a slip of the pen, not a lens.
constexpr double kMostFocal_px = 1e6;
constexpr double kMostDistortion = 1e3;
constexpr double kMostDistance_mm = 1e6;
constexpr std::size_t kMaxName = 128;
constexpr std::size_t kMaxProjectors = 16;
constexpr std::size_t kMaxLights = 16;
/// The largest element of R R^T - I, and of |q| - 1. Written by write_rig it is 1e-15; a matrix that was
/// typed with seven digits passes.
constexpr double kMostSkew = 1e-6;

std::string read_name(TomlSection& section) {
  std::string name;
  section.read("name", name);
  const bool control =
      std::any_of(name.begin(), name.end(), [](char c) { return (c >= 0 && c < ' ') || c == '\x7f'; });
  if (section.given() && (name.empty() || name.size() > kMaxName || control)) {
    section.fail(section.node(), "name",
                 fmt::format("must be a text of 1 to {} characters without control characters", kMaxName));
  }
  return name;
}

/// The rotation that a section gives as three rows or as a quaternion.
Eigen::Matrix3d read_rotation(TomlSection& section) {
  std::array<double, 4> quaternion{1, 0, 0, 0};
  const toml::node* given_quaternion = section.read_numbers("quaternion", quaternion, -1.1, 1.1);
  const toml::node* given_rows = section.find("rotation");
  if (section.given() && (given_rows == nullptr) == (given_quaternion == nullptr)) {
    section.fail(section.node(), "rotation",
                 "give either rotation (three rows of three numbers) or quaternion (w, x, y, z)");
  }
  if (given_quaternion != nullptr) {
    const Eigen::Quaterniond turn(quaternion[0], quaternion[1], quaternion[2], quaternion[3]);
    if (std::abs(turn.norm() - 1) > kMostSkew) {
      section.fail(given_quaternion, "quaternion",
                   fmt::format("must have length 1, has {:.9g}: w, x, y, z in this order", turn.norm()));
    }
    return turn.normalized().toRotationMatrix();
  }
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  if (given_rows == nullptr) {
    return turn;
  }
  constexpr const char* kRows = "must be three rows of three numbers from -1 to 1";
  const toml::array* rows = given_rows->as_array();
  if (rows == nullptr || rows->size() != 3) {
    section.fail(given_rows, "rotation", kRows);
  }
  for (std::size_t y = 0; y < 3; ++y) {
    const toml::array* row = rows->get(y)->as_array();
    for (std::size_t x = 0; x < 3; ++x) {
      const toml::node* node = row != nullptr && row->size() == 3 ? row->get(x) : nullptr;
      const std::optional<double> found =
          node != nullptr && node->is_number() ? node->value<double>() : std::nullopt;
      if (!found || !(std::abs(*found) <= 1 + kMostSkew)) {
        section.fail(rows->get(y), "rotation", kRows);
      }
      turn(static_cast<Eigen::Index>(y), static_cast<Eigen::Index>(x)) = *found;
    }
  }
  const double skew = (turn * turn.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(skew <= kMostSkew)) {
    section.fail(
        given_rows, "rotation",
        fmt::format("is no rotation: its rows are not unit vectors at right angles (off by {:.2g}, at "
                    "most {:g} is allowed)",
                    skew, kMostSkew));
  }
  if (turn.determinant() < 0) {
    section.fail(given_rows, "rotation", "is a mirror image, not a rotation: its determinant is -1");
  }
  return turn;
}

void read_lens(TomlSection& section, Lens& lens) {
  constexpr std::array kNeeded = {"name",  "width_px", "height_px",  "fx_px",         "fy_px",
                                  "cx_px", "cy_px",    "distortion", "translation_mm"};
  section.require(kNeeded);
  section.read_integer("width_px", lens.width_px, 16, 65536);
  section.read_integer("height_px", lens.height_px, 16, 65536);
  section.read_number("fx_px", lens.fx_px, 1, kMostFocal_px);
  section.read_number("fy_px", lens.fy_px, 1, kMostFocal_px);
  // A projector's principal point often lies at the edge of its picture or below it (lens shift).
  section.read_number("cx_px", lens.cx_px, -lens.width_px, 2.0 * lens.width_px);
  section.read_number("cy_px", lens.cy_px, -lens.height_px, 2.0 * lens.height_px);
  std::array<double, 5> distortion{};
  section.read_numbers("distortion", distortion, -kMostDistortion, kMostDistortion);
  lens.distortion = {distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]};
  lens.camera_from_rig.linear() = read_rotation(section);
  std::array<double, 3> translation{};
  section.read_numbers("translation_mm", translation, -kMostDistance_mm, kMostDistance_mm);
  lens.camera_from_rig.translation() << translation[0], translation[1], translation[2];
}

template <typename Device>
std::optional<std::size_t> index_of(const std::vector<Device>& devices, const std::string& name) {
  const auto at =
      std::find_if(devices.begin(), devices.end(), [&](const Device& device) { return device.name == name; });
  return at == devices.end() ? std::nullopt : std::optional<std::size_t>(at - devices.begin());
}

template <typename Device>
void add_unique(const TomlSection& section, std::vector<Device>& devices, const Device& device,
                std::size_t most, const char* what) {
  if (index_of(devices, device.name)) {
    section.fail(section.node(), "name", fmt::format("there is a {} '{}' already", what, device.name));
  }
  if (devices.size() == most) {
    section.fail(section.node(), "name", fmt::format("there are more than {} {}s", most, what));
  }
  devices.push_back(device);
}

void read_camera(TomlSection& section, Rig& rig) {
  RigCamera camera;
  camera.name = read_name(section);
  read_lens(section, camera.lens);
  section.read("colour", camera.colour);
  section.finish();
  if (section.given()) {
    add_unique(section, rig.cameras, camera, kMaxCameras, "camera");
  }
}

void read_projector(TomlSection& section, Rig& rig) {
  RigProjector projector;
  projector.name = read_name(section);
  read_lens(section, projector.lens);
  section.finish();
  if (section.given()) {
    add_unique(section, rig.projectors, projector, kMaxProjectors, "projector");
  }
}

void read_light(TomlSection& section, Rig& rig) {
  RigLight light;
  light.name = read_name(section);
  constexpr std::array kNeeded = {"name", "position_mm"};
  section.require(kNeeded);
  std::array<double, 3> position{};
  section.read_numbers("position_mm", position, -kMostDistance_mm, kMostDistance_mm);
  light.position_mm << position[0], position[1], position[2];
  section.read_number("strength", light.strength, 1e-3, 1e3);
  section.finish();
  if (light.name.find_first_of("+,") != std::string::npos) {
    section.fail(section.node(), "name", "must have no + and no comma: slots name several lights with them");
  }
  if (section.given() && index_of(rig.projectors, light.name)) {
    section.fail(section.node(), "name",
                 fmt::format("there is a projector '{}': it is a light by its own name", light.name));
  }
  if (section.given()) {
    add_unique(section, rig.lights, light, kMaxLights, "light");
  }
}

std::size_t read_pair_side(TomlSection& section, const char* side, const Rig& rig) {
  std::string name;
  section.read(side, name);
  const std::optional<std::size_t> at = index_of(rig.cameras, name);
  if (section.given() && !at) {
    section.fail(section.node(), side, fmt::format("there is no camera '{}'", name));
  }
  return at.value_or(0);
}

void read_pair(TomlSection& section, Rig& rig) {
  constexpr std::array kNeeded = {"left", "right"};
  section.require(kNeeded);
  const StereoPair pair{read_pair_side(section, "left", rig), read_pair_side(section, "right", rig)};
  section.finish();
  if (!section.given()) {
    return;
  }
  if (pair.left == pair.right) {
    section.fail(section.node(), "right", "a pair needs two cameras");
  }
  const auto same = [&](const StereoPair& other) {
    return (other.left == pair.left && other.right == pair.right) ||
           (other.left == pair.right && other.right == pair.left);
  };
  if (std::any_of(rig.pairs.begin(), rig.pairs.end(), same)) {
    section.fail(section.node(), "left", "these two cameras are a pair already");
  }
  rig.pairs.push_back(pair);
}

void read_all(files::TomlDocument& document, Rig& rig) {
  TomlSection root(document, &document.root(), "");
  for (TomlSection& camera : root.sections("camera")) {
    read_camera(camera, rig);
  }
  for (TomlSection& pair : root.sections("pair")) {
    read_pair(pair, rig);
  }
  for (TomlSection& projector : root.sections("projector")) {
    read_projector(projector, rig);
  }
  for (TomlSection& light : root.sections("light")) {
    read_light(light, rig);
  }
  root.finish();
  if (rig.cameras.empty()) {
    document.fail(nullptr, "camera", "there is none: a rig has one [[camera]] or more");
  }
}

/// A TOML text in quotes. Control characters, which no name has, stay as they are and are refused by the
/// parser.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
    }
    out += c;
  }
  return out + '"';
}

/// The shortest digits that read back as the same number; TOML's integers, which "-0" would be one of, have
/// no sign of 0.
std::string number(double value) {
  return value == 0 && std::signbit(value) ? "-0.0" : fmt::format("{}", value);
}

std::string numbers(std::initializer_list<double> values) {
  std::string text;
  for (const double value : values) {
    text += (text.empty() ? "" : ", ") + number(value);
  }
  return "[" + text + "]";
}

void format_lens(fmt::memory_buffer& text, const std::string& name, const Lens& lens) {
  const auto out = std::back_inserter(text);
  const LensDistortion& bent = lens.distortion;
  fmt::format_to(out, "name = {}\nwidth_px = {}\nheight_px = {}\n", quoted(name), lens.width_px,
                 lens.height_px);
  fmt::format_to(out, "fx_px = {}\nfy_px = {}\ncx_px = {}\ncy_px = {}\n", number(lens.fx_px),
                 number(lens.fy_px), number(lens.cx_px), number(lens.cy_px));
  fmt::format_to(out, "distortion = {}\n", numbers({bent.k1, bent.k2, bent.p1, bent.p2, bent.k3}));
  const Eigen::Matrix3d turn = lens.camera_from_rig.linear();
  fmt::format_to(out, "rotation = [\n");
  for (Eigen::Index y = 0; y < 3; ++y) {
    fmt::format_to(out, "  {},\n", numbers({turn(y, 0), turn(y, 1), turn(y, 2)}));
  }
  const Eigen::Vector3d at = lens.camera_from_rig.translation();
  fmt::format_to(out, "]\ntranslation_mm = {}\n", numbers({at.x(), at.y(), at.z()}));
}

}  // namespace

Rig parse_rig(std::string_view text, const std::filesystem::path& file) {
  Rig rig;
  files::read_toml(text, file, [&](files::TomlDocument& document) { read_all(document, rig); });
  return rig;
}

Rig read_rig(const std::filesystem::path& file) {
  return parse_rig(files::read_text(file, kMaxRigFileBytes, "rig file"), file);
}

std::string format_rig(const Rig& rig) {
  fmt::memory_buffer text;
  const auto out = std::back_inserter(text);
  fmt::format_to(out,
                 "# Facet: a calibrated rig. Lengths are mm, pixel centres at whole numbers; a point is "
                 "seen at rotation * point +\n# translation_mm in a camera's frame: x right, y down, z "
                 "forward.\n");
  for (const RigCamera& camera : rig.cameras) {
    fmt::format_to(out, "\n[[camera]]\n");
    format_lens(text, camera.name, camera.lens);
    fmt::format_to(out, "colour = {}\n", camera.colour);
  }
  for (const StereoPair& pair : rig.pairs) {
    fmt::format_to(out, "\n[[pair]]\nleft = {}\nright = {}\n", quoted(rig.cameras.at(pair.left).name),
                   quoted(rig.cameras.at(pair.right).name));
  }
  for (const RigProjector& projector : rig.projectors) {
    fmt::format_to(out, "\n[[projector]]\n");
    format_lens(text, projector.name, projector.lens);
  }
  for (const RigLight& light : rig.lights) {
    fmt::format_to(out, "\n[[light]]\nname = {}\nposition_mm = {}\nstrength = {}\n", quoted(light.name),
                   numbers({light.position_mm.x(), light.position_mm.y(), light.position_mm.z()}),
                   number(light.strength));
  }
  return fmt::to_string(text);
}

void write_rig(const Rig& rig, const std::filesystem::path& file) {
  const std::string text = format_rig(rig);
  parse_rig(text, file);  // what nobody could read is not written
  files::OutputFile output(file);
  output.write(text);
  output.commit();
}

}  // namespace facet::capture
