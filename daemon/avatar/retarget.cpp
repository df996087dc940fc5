#include "avatar/retarget.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <stdexcept>

#include "facet/error.hpp"

namespace facet::avatar {
namespace {

using Json = nlohmann::ordered_json;

/// Targets of all meshes; an avatar has some hundreds.
constexpr std::size_t kMostTargets = 100'000;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return static_cast<char>(std::tolower(static_cast<unsigned char>(c))); });
  return text;
}

/// Index into mesh::kArkitNames; -1 for a shape that is none of them.
int shape_of(const std::string& name) {
  std::string plain = lower(name.substr(name.rfind('.') + 1));
  for (const auto& [ending, word] : {std::pair{"_l", "left"}, {"_r", "right"}}) {
    if (plain.ends_with(ending)) {
      plain = plain.substr(0, plain.size() - 2) + word;
    }
  }
  for (std::size_t i = 0; i < mesh::kArkitNames.size(); ++i) {
    if (lower(std::string(mesh::kArkitNames[i])) == plain) {
      return static_cast<int>(i);
    }
  }
  return -1;
}

/// A list of the document; an empty one where it is not there.
const Json& list(const Json& json, const char* name) {
  static const Json kEmpty = Json::array();
  const auto found = json.find(name);
  if (found == json.end()) {
    return kEmpty;
  }
  if (!found->is_array()) {
    throw std::runtime_error(fmt::format("{} are no list", name));
  }
  return *found;
}

Eigen::Quaternionf rotation_of(const Json& node) {
  if (const auto rotation = node.find("rotation"); rotation != node.end()) {
    const auto values = rotation->get<std::array<float, 4>>();
    const Eigen::Quaternionf turn(Eigen::Map<const Eigen::Vector4f>(values.data()));
    if (!(turn.norm() > 0.5F && turn.norm() < 2.0F)) {
      throw std::runtime_error("a node's rotation is none");
    }
    return turn.normalized();
  }
  if (const auto matrix = node.find("matrix"); matrix != node.end()) {
    const auto values = matrix->get<std::array<float, 16>>();
    const Eigen::Map<const Eigen::Matrix4f> all(values.data());  // column by column, as Eigen has them
    const Eigen::Matrix3f axes = all.topLeftCorner<3, 3>().colwise().normalized();
    if (!axes.allFinite() || !(axes.determinant() > 0.1F)) {
      throw std::runtime_error("a node's matrix mirrors or flattens");
    }
    return Eigen::Quaternionf(axes).normalized();
  }
  return Eigen::Quaternionf::Identity();
}

/// [node_count] parent of each node; -1 for roots.
std::vector<std::ptrdiff_t> parents_of(const Json& nodes) {
  std::vector<std::ptrdiff_t> parents(nodes.size(), -1);
  for (std::size_t node = 0; node < nodes.size(); ++node) {
    for (const Json& child : list(nodes.at(node), "children")) {
      parents.at(child.get<std::size_t>()) = static_cast<std::ptrdiff_t>(node);
    }
  }
  return parents;
}

/// The index of the node that the document names as the head's bone, by its extension "VRMC_vrm" (VRM 1) or
/// "VRM" (VRM 0); nothing where it has neither. Sets faces_backwards where it is VRM 0, whose avatars look
/// along -z.
std::optional<std::size_t> vrm_head(const Json& json, bool& faces_backwards) {
  const auto extensions = json.find("extensions");
  if (extensions == json.end()) {
    return std::nullopt;
  }
  if (const auto vrm = extensions->find("VRMC_vrm"); vrm != extensions->end()) {
    return vrm->at("humanoid").at("humanBones").at("head").at("node").get<std::size_t>();
  }
  if (const auto vrm = extensions->find("VRM"); vrm != extensions->end()) {
    faces_backwards = true;
    for (const Json& bone : vrm->at("humanoid").at("humanBones")) {
      if (bone.at("bone") == "head") {
        return bone.at("node").get<std::size_t>();
      }
    }
  }
  return std::nullopt;
}

std::optional<std::size_t> find_head(const Json& json, const std::optional<std::string>& name,
                                     Avatar& avatar) {
  const Json& nodes = list(json, "nodes");
  const std::optional<std::size_t> vrm = vrm_head(json, avatar.faces_backwards);
  for (std::size_t node = 0; node < nodes.size() && name; ++node) {
    if (nodes.at(node).value("name", "") == *name) {
      return node;
    }
  }
  if (name || vrm) {
    return name ? std::nullopt : vrm;
  }
  for (std::size_t node = 0; node < nodes.size(); ++node) {
    if (lower(nodes.at(node).value("name", "")).ends_with("head")) {
      return node;
    }
  }
  return std::nullopt;
}

std::vector<AvatarMesh> find_meshes(const Json& json, std::vector<std::string>& shape_names) {
  const Json& nodes = list(json, "nodes");
  const Json& meshes = list(json, "meshes");
  std::vector<std::vector<std::size_t>> nodes_of(meshes.size());
  for (std::size_t node = 0; node < nodes.size(); ++node) {
    if (const auto shown = nodes.at(node).find("mesh"); shown != nodes.at(node).end()) {
      nodes_of.at(shown->get<std::size_t>()).push_back(node);
    }
  }
  std::vector<AvatarMesh> found;
  for (std::size_t i = 0; i < meshes.size(); ++i) {
    const Json& mesh = meshes.at(i);
    const std::size_t count = list(mesh.at("primitives").at(0), "targets").size();
    if (count == 0 || !mesh.contains("extras") || !mesh.at("extras").is_object()) {
      continue;
    }
    const Json& names = list(mesh.at("extras"), "targetNames");
    AvatarMesh entry;
    entry.mesh = i;
    entry.resting_weights = mesh.value("weights", std::vector<float>());
    entry.resting_weights.resize(count, 0.0F);
    entry.shapes.assign(count, -1);
    if (shape_names.size() + count > kMostTargets) {
      throw std::runtime_error("it has too many morph targets");
    }
    for (std::size_t target = 0; target < std::min(count, names.size()); ++target) {
      shape_names.push_back(names.at(target).get<std::string>());
      entry.shapes[target] = shape_of(shape_names.back());
    }
    entry.nodes = nodes_of[i];
    if (!entry.nodes.empty() &&
        std::any_of(entry.shapes.begin(), entry.shapes.end(), [](int shape) { return shape >= 0; })) {
      found.push_back(std::move(entry));
    }
  }
  return found;
}

Avatar inspect(const Json& json, const std::optional<std::string>& head_name) {
  Avatar avatar;
  avatar.meshes = find_meshes(json, avatar.shape_names);
  avatar.head = find_head(json, head_name, avatar);
  if (avatar.head) {
    const Json& nodes = list(json, "nodes");
    const std::vector<std::ptrdiff_t> parents = parents_of(nodes);
    avatar.head_at_rest = rotation_of(nodes.at(*avatar.head));
    std::size_t steps = 0;
    for (std::ptrdiff_t node = parents.at(*avatar.head); node >= 0;
         node = parents[static_cast<std::size_t>(node)]) {
      if (++steps > nodes.size()) {
        throw std::runtime_error("its nodes go in a circle");
      }
      avatar.world_from_parent =
          rotation_of(nodes.at(static_cast<std::size_t>(node))) * avatar.world_from_parent;
    }
  }
  return avatar;
}

/// A node that an animation turns must have its parts apart.
void split_matrix(Json& node) {
  const auto matrix = node.find("matrix");
  if (matrix == node.end()) {
    return;
  }
  const Eigen::Quaternionf turn = rotation_of(node);
  const auto values = matrix->get<std::array<float, 16>>();
  const Eigen::Map<const Eigen::Matrix4f> all(values.data());
  const Eigen::RowVector3f scale = all.topLeftCorner<3, 3>().colwise().norm();
  node.erase("matrix");
  node["translation"] = {values[12], values[13], values[14]};
  node["rotation"] = {turn.x(), turn.y(), turn.z(), turn.w()};
  node["scale"] = {scale[0], scale[1], scale[2]};
}

/// [frame_count][4] x y z w: the head's rotation against its parent.
std::vector<float> head_turns(const Avatar& avatar, const std::vector<FaceState>& states) {
  // world = turn * rest; the parent stays at rest. Where the avatar looks along -z, our x and z are its -x
  // and -z.
  const Eigen::Quaternionf world_from_upright =
      avatar.faces_backwards ? Eigen::Quaternionf(0, 0, 1, 0) : Eigen::Quaternionf::Identity();
  std::vector<float> turns;
  Eigen::Quaternionf before = Eigen::Quaternionf::Identity();
  for (const FaceState& state : states) {
    const Eigen::Quaternionf turn = world_from_upright *
                                    Eigen::Quaternionf(state.upright_from_head.linear()) *
                                    world_from_upright.conjugate();
    Eigen::Quaternionf local =
        (avatar.world_from_parent.conjugate() * turn * avatar.world_from_parent * avatar.head_at_rest)
            .normalized();
    // The same turn has two quaternions; neighbours are of the same half, or players spin.
    if (!turns.empty() && before.dot(local) < 0) {
      local.coeffs() = -local.coeffs();
    }
    before = local;
    turns.insert(turns.end(), local.coeffs().data(), local.coeffs().data() + 4);
  }
  return turns;
}

}  // namespace

Avatar inspect_avatar(const GlbDocument& glb, const std::optional<std::string>& head_name) {
  try {
    Avatar avatar = inspect(glb.json, head_name);
    if (avatar.head || !head_name) {
      return avatar;
    }
  } catch (const std::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("the avatar: {}", error.what()));
  }
  std::string names;
  for (const auto& node : glb.json.value("nodes", Json::array())) {
    names += fmt::format("{}'{}'", names.empty() ? "" : ", ", node.value("name", ""));
  }
  throw Error(ErrorKind::Usage, fmt::format("the avatar has no node '{}'; it has {}", *head_name, names));
}

std::vector<std::size_t> missing_shapes(const Avatar& avatar, const std::vector<std::size_t>& wanted) {
  std::vector<std::size_t> missing;
  std::copy_if(wanted.begin(), wanted.end(), std::back_inserter(missing), [&](std::size_t shape) {
    return std::none_of(avatar.meshes.begin(), avatar.meshes.end(), [&](const AvatarMesh& mesh) {
      return std::find(mesh.shapes.begin(), mesh.shapes.end(), static_cast<int>(shape)) != mesh.shapes.end();
    });
  });
  return missing;
}

void add_animation(GlbDocument& glb, const Avatar& avatar, const std::vector<FaceState>& states,
                   const std::vector<float>& times_s, bool with_head) {
  const std::size_t input = append_floats(glb, times_s, "SCALAR", times_s.size(),
                                          {{"min", {times_s.front()}}, {"max", {times_s.back()}}});
  Json samplers = Json::array();
  Json channels = Json::array();
  const auto animate = [&](std::size_t node, const char* path, std::size_t output) {
    samplers.push_back({{"input", input}, {"output", output}, {"interpolation", "LINEAR"}});
    channels.push_back({{"sampler", samplers.size() - 1}, {"target", {{"node", node}, {"path", path}}}});
  };
  for (const AvatarMesh& mesh : avatar.meshes) {
    std::vector<float> weights;
    for (const FaceState& state : states) {
      for (std::size_t target = 0; target < mesh.shapes.size(); ++target) {
        const int shape = mesh.shapes[target];
        weights.push_back(shape >= 0 ? state.values.at(static_cast<std::size_t>(shape))
                                     : mesh.resting_weights[target]);
      }
    }
    const std::size_t output = append_floats(glb, weights, "SCALAR", weights.size(), Json::object());
    for (const std::size_t node : mesh.nodes) {
      animate(node, "weights", output);
    }
  }
  try {
    if (with_head && avatar.head) {
      split_matrix(glb.json.at("nodes").at(*avatar.head));
      animate(*avatar.head, "rotation",
              append_floats(glb, head_turns(avatar, states), "VEC4", states.size(), Json::object()));
    }
    if (!glb.json.contains("animations")) {
      glb.json["animations"] = Json::array();
    }
    Json& animations = glb.json.at("animations");
    animations.push_back(
        {{"name", "facet"}, {"samplers", std::move(samplers)}, {"channels", std::move(channels)}});
  } catch (const Json::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("the avatar: {}", error.what()));
  }
}

}  // namespace facet::avatar
