#include <assimp/scene.h>

#include <algorithm>
#include <assimp/Exporter.hpp>
#include <cmath>
#include <memory>
#include <string>
#include <utility>

#include "exports/export_sequence.hpp"
#include "exports/fbx_document.hpp"
#include "facet/error.hpp"
#include "maths/srgb.hpp"

namespace facet::exports {
namespace {

/// The unit that the format's readers take for granted.
constexpr float kCentimetresPerMillimetre = 0.1F;
/// FBX counts time in these.
constexpr double kTicksPerSecond = 46186158000;
constexpr const char* kNode = "head";

aiVector3D assimp_vector(const Eigen::Vector3f& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

/// As aiMesh and aiAnimMesh own them. factor: of every number.
aiVector3D* assimp_vectors(const Eigen::Matrix3Xf& vectors, float factor) {
  auto* out = new aiVector3D[static_cast<std::size_t>(vectors.cols())];
  for (Eigen::Index i = 0; i < vectors.cols(); ++i) {
    out[i] = assimp_vector(factor * vectors.col(i));
  }
  return out;
}

void add_triangles(aiMesh& out, const mesh::Triangles& triangles) {
  out.mPrimitiveTypes = aiPrimitiveType_TRIANGLE;
  out.mNumFaces = static_cast<unsigned>(triangles.cols());
  out.mFaces = new aiFace[out.mNumFaces];
  for (unsigned t = 0; t < out.mNumFaces; ++t) {
    out.mFaces[t].mNumIndices = 3;
    out.mFaces[t].mIndices = new unsigned[3];
    std::copy_n(triangles.col(t).begin(), 3, out.mFaces[t].mIndices);
  }
}

void add_shapes(aiMesh& out, const ExpressionShapes& shapes, const mesh::Triangles& triangles) {
  out.mNumAnimMeshes = static_cast<unsigned>(shapes.names.size());
  out.mAnimMeshes = new aiAnimMesh*[out.mNumAnimMeshes]();
  Eigen::Matrix3Xf normals;
  for (unsigned e = 0; e < out.mNumAnimMeshes; ++e) {
    const mesh::Vertices shape_mm = shapes.neutral_mm + shapes.deltas_mm[e];
    mesh::vertex_normals(shape_mm, triangles, normals);
    mend_normals(normals);
    auto* shape = new aiAnimMesh;
    out.mAnimMeshes[e] = shape;
    shape->mName = shapes.names[e];
    shape->mNumVertices = out.mNumVertices;
    shape->mVertices = assimp_vectors(shape_mm, kCentimetresPerMillimetre);
    shape->mNormals = assimp_vectors(normals, 1);
  }
}

aiMesh* assimp_mesh(const ExportMesh& neutral, const ExpressionShapes& shapes) {
  auto* out = new aiMesh;
  out->mName = kNode;
  out->mNumVertices = static_cast<unsigned>(neutral.vertices_mm.cols());
  out->mVertices = assimp_vectors(neutral.vertices_mm, kCentimetresPerMillimetre);
  out->mNormals = assimp_vectors(neutral.normals, 1);
  out->mNumUVComponents[0] = 2;
  out->mTextureCoords[0] = new aiVector3D[out->mNumVertices];
  for (unsigned v = 0; v < out->mNumVertices; ++v) {
    out->mTextureCoords[0][v] = {neutral.texture_coordinates(0, v), neutral.texture_coordinates(1, v), 0};
  }
  if (neutral.skin_png == nullptr && neutral.albedo.cols() > 0) {
    out->mColors[0] = new aiColor4D[out->mNumVertices];
    for (unsigned v = 0; v < out->mNumVertices; ++v) {
      const Eigen::Vector3f colour =
          neutral.albedo.col(v).cwiseMax(0.0F).cwiseMin(1.0F).unaryExpr(&maths::encode_srgb);
      out->mColors[0][v] = {colour.x(), colour.y(), colour.z(), 1};
    }
  }
  add_triangles(*out, neutral.triangles);
  add_shapes(*out, shapes, neutral.triangles);
  return out;
}

void add_material(aiScene& scene, const ExportMesh& neutral) {
  auto* material = new aiMaterial;
  scene.mMaterials = new aiMaterial* [1] { material };
  scene.mNumMaterials = 1;
  const aiString name("skin");
  material->AddProperty(&name, AI_MATKEY_NAME);
  const aiColor3D white(1, 1, 1);
  material->AddProperty(&white, 1, AI_MATKEY_COLOR_DIFFUSE);
  if (neutral.skin_png == nullptr) {
    return;
  }
  auto* picture = new aiTexture;
  scene.mTextures = new aiTexture* [1] { picture };
  scene.mNumTextures = 1;
  picture->mFilename = "albedo.png";
  std::copy_n("png", 4, picture->achFormatHint);
  picture->mWidth = static_cast<unsigned>(neutral.skin_png->size());  // bytes, where the height is 0
  picture->pcData = new aiTexel[neutral.skin_png->size() / sizeof(aiTexel) + 1];
  std::copy(neutral.skin_png->begin(), neutral.skin_png->end(),
            reinterpret_cast<std::uint8_t*>(picture->pcData));
  const aiString path(picture->mFilename);  // by its number readers would not find it
  material->AddProperty(&path, AI_MATKEY_TEXTURE_DIFFUSE(0));
}

/// The head's node with its movement; all curves of it have a key for every frame.
void add_movement(aiScene& scene, const std::vector<Eigen::Isometry3f>& poses_m,
                  const std::vector<double>& times_s) {
  auto* movement = new aiNodeAnim;
  auto* animation = new aiAnimation;
  scene.mAnimations = new aiAnimation* [1] { animation };
  scene.mNumAnimations = 1;
  animation->mName = "take";
  animation->mTicksPerSecond = 1;
  animation->mDuration = times_s.back();
  animation->mChannels = new aiNodeAnim* [1] { movement };
  animation->mNumChannels = 1;
  movement->mNodeName = kNode;
  movement->mNumPositionKeys = movement->mNumRotationKeys = static_cast<unsigned>(poses_m.size());
  movement->mPositionKeys = new aiVectorKey[poses_m.size()];
  movement->mRotationKeys = new aiQuatKey[poses_m.size()];
  for (std::size_t i = 0; i < poses_m.size(); ++i) {
    const Eigen::Vector3f place_cm =
        kCentimetresPerMillimetre / kMetresPerMillimetre * poses_m[i].translation();
    const Eigen::Quaternionf turn(poses_m[i].linear());
    movement->mPositionKeys[i] = {times_s[i], assimp_vector(place_cm)};
    movement->mRotationKeys[i] = {times_s[i], aiQuaternion(turn.w(), turn.x(), turn.y(), turn.z())};
  }
  movement->mNumScalingKeys = 1;
  movement->mScalingKeys = new aiVectorKey[1]{{0, {1, 1, 1}}};
}

/// What an FBX record's name is before the separator.
std::string_view name_of(const FbxRecord& object) {
  const std::string_view name = fbx_text(object.split_properties().at(1));
  return name.substr(0, name.find('\0'));
}

/// A curve with a straight line from key to key.
FbxRecord curve_of(std::int64_t id, std::span<const std::int64_t> times, std::span<const float> values) {
  constexpr std::int32_t kLinear = 4;
  const auto count = static_cast<std::int32_t>(values.size());
  FbxRecord curve("AnimationCurve");
  curve.add(id).add(std::string_view("\0\1AnimCurve", 11)).add(std::string_view());
  curve.child("Default").add(static_cast<double>(values.front()));
  curve.child("KeyVer").add(std::int32_t{4009});
  curve.child("KeyTime").add(times);
  curve.child("KeyValueFloat").add(values);
  curve.child("KeyAttrFlags").add(std::span(&kLinear, 1));
  constexpr std::array<float, 4> kNoTangents{};
  curve.child("KeyAttrDataFloat").add(std::span<const float>(kNoTangents));
  curve.child("KeyAttrRefCount").add(std::span(&count, 1));
  return curve;
}

FbxRecord curve_node_of(std::int64_t id, double value) {
  FbxRecord node("AnimationCurveNode");
  node.add(id).add(std::string_view("DeformPercent\0\1AnimCurveNode", 28)).add(std::string_view());
  node.child("Properties70").child("P").add("d|DeformPercent").add("Number").add("").add("A").add(value);
  return node;
}

void connect(FbxRecord& connections, std::int64_t from, std::int64_t to, std::string_view property) {
  FbxRecord& line = connections.child("C");
  line.add(property.empty() ? "OO" : "OP").add(from).add(to);
  if (!property.empty()) {
    line.add(property);
  }
}

/// Counts further objects of a kind in the file's definitions.
void count_objects(FbxRecord& definitions, std::string_view kind, std::int32_t more) {
  const auto add = [more](FbxRecord& count) {
    const auto before = static_cast<std::int32_t>(fbx_integer(count.split_properties().at(0)));
    count = FbxRecord("Count");
    count.add(before + more);
  };
  add(definitions.find("Count"));
  for (FbxRecord& type : definitions.children) {
    if (type.name == "ObjectType" && fbx_text(type.split_properties().at(0)) == kind) {
      add(type.find("Count"));
      return;
    }
  }
  throw Error(ErrorKind::Internal, "export: an FBX file without animation");
}

/// Puts right what Assimp 5.2.5 does to a file's objects: it calls shapes and their mesh's deformer
/// "Blendshape" and "Blendshapes", which Blender refuses, and leaves an empty list out, which its own reader
/// wants.
void mend_objects(FbxRecord& objects) {
  objects.find("AnimationLayer").has_list = true;
  for (FbxRecord& object : objects.children) {
    const auto properties = object.split_properties();
    const std::string type(fbx_text(properties.at(2)));
    const std::string_view kind = object.name == "Geometry" && type == "Shape"        ? "Geometry"
                                  : object.name == "Deformer" && type == "BlendShape" ? "Deformer"
                                                                                      : "";
    if (!kind.empty()) {
      const std::int64_t id = fbx_integer(properties.at(0));
      std::string name(name_of(object));
      name.append("\0\1", 2).append(kind);
      object.properties.clear();
      object.property_count = 0;
      object.add(id).add(name).add(type);
    }
  }
}

/// Puts the curves of the shapes' weights into a file that Assimp wrote: the exporter of 5.2.5 writes the
/// shapes and the movement of nodes, but leaves aiMeshMorphAnim out.
///
/// times    [frames] ticks
/// weights  [shapes][frames] percent
void add_weight_curves(FbxDocument& document, const std::vector<std::string>& names,
                       std::span<const std::int64_t> times, const std::vector<std::vector<float>>& weights) {
  FbxRecord& objects = document.root.find("Objects");
  FbxRecord& connections = document.root.find("Connections");
  const std::int64_t layer = fbx_integer(objects.find("AnimationLayer").split_properties().at(0));
  std::int64_t next = 0;
  std::vector<std::pair<std::int64_t, std::size_t>> channels;
  for (const FbxRecord& object : objects.children) {
    const auto properties = object.split_properties();
    next = std::max(next, fbx_integer(properties.at(0)) + 1);
    if (object.name == "Deformer" && fbx_text(properties.at(2)) == "BlendShapeChannel") {
      const auto shape = std::find(names.begin(), names.end(), name_of(object)) - names.begin();
      channels.emplace_back(fbx_integer(properties.at(0)), static_cast<std::size_t>(shape));
    }
  }
  if (channels.size() != names.size()) {
    throw Error(ErrorKind::Internal, "export: an FBX file with another number of shapes");
  }
  for (const auto& [channel, shape] : channels) {
    const std::vector<float>& values = weights.at(shape);
    const std::int64_t node = next++;
    const std::int64_t curve = next++;
    objects.children.push_back(curve_node_of(node, static_cast<double>(values.front())));
    objects.children.push_back(curve_of(curve, times, values));
    connect(connections, node, layer, "");
    connect(connections, node, channel, "DeformPercent");
    connect(connections, curve, node, "d|DeformPercent");
  }
  const auto count = static_cast<std::int32_t>(channels.size());
  count_objects(document.root.find("Definitions"), "AnimationCurveNode", count);
  count_objects(document.root.find("Definitions"), "AnimationCurve", count);
}

/// The neutral face with a blend shape for each expression, moved by the head's pose. Assimp writes what it
/// can, the weights' curves are added.
class FbxWriter final : public SequenceWriter {
 public:
  FbxWriter(const SequenceOptions& options, const SequenceFrame& first)
      : options_(options),
        neutral_(neutral_mesh(options.shapes, first.mesh)),
        out_(options.file),
        weights_(options.shapes.names.size()) {}

  void add(const SequenceFrame& frame) override {
    require_same_mesh(neutral_.triangles, frame, options_.file);
    poses_m_.push_back(metres_from_head(frame));
    times_s_.push_back(time_s(options_.timeline, frame.sequence));
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      weights_[e].push_back(e < frame.expression.size() ? 100 * frame.expression[e] : 0.0F);
    }
  }

  void commit() override {
    const std::unique_ptr<aiScene> scene = make_scene();
    Assimp::ExportProperties properties;
    properties.SetPropertyBool("bJoinIdenticalVertices", false);
    Assimp::Exporter exporter;
    const aiExportDataBlob* blob = exporter.ExportToBlob(scene.get(), "fbx", 0, &properties);
    if (blob == nullptr) {
      throw Error(ErrorKind::Internal, std::string("export: Assimp: ") + exporter.GetErrorString());
    }
    FbxDocument document(std::span(static_cast<const std::byte*>(blob->data), blob->size));
    mend_objects(document.root.find("Objects"));
    std::vector<std::int64_t> ticks;
    for (const double time : times_s_) {
      ticks.push_back(std::llround(time * kTicksPerSecond));
    }
    add_weight_curves(document, options_.shapes.names, ticks, weights_);
    out_.write(document.bytes());
    out_.commit();
  }

 private:
  std::unique_ptr<aiScene> make_scene() const {
    auto scene = std::make_unique<aiScene>();
    scene->mMeshes = new aiMesh* [1] { assimp_mesh(neutral_, options_.shapes) };
    scene->mNumMeshes = 1;
    add_material(*scene, neutral_);
    auto* node = new aiNode(kNode);
    node->mMeshes = new unsigned[1]{0};
    node->mNumMeshes = 1;
    scene->mRootNode = new aiNode("face");
    scene->mRootNode->addChildren(1, &node);
    add_movement(*scene, poses_m_, times_s_);
    // FBX's name for a rate of its own, and the rate.
    constexpr std::int32_t kCustomRate = 14;
    scene->mMetaData = aiMetadata::Alloc(2);
    scene->mMetaData->Set(0, "TimeMode", kCustomRate);
    scene->mMetaData->Set(1, "CustomFrameRate", options_.timeline.rate_hz);
    return scene;
  }

  SequenceOptions options_;
  ExportMesh neutral_;
  files::OutputFile out_;
  std::vector<Eigen::Isometry3f> poses_m_;
  std::vector<double> times_s_;
  std::vector<std::vector<float>> weights_;  ///< [shapes][frames] percent
};

}  // namespace

std::unique_ptr<SequenceWriter> open_fbx(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<FbxWriter>(options, first);
}

}  // namespace facet::exports
