#include "landmark/attention_net.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

#include "facet/error.hpp"
#include "landmark/landmark_layout.hpp"

namespace facet::landmark {
namespace {

constexpr int kInputSide = FacePicture::side;
constexpr int kFeatureSide = 48;
constexpr int kFeatureChannels = 32;
constexpr int kCropSide = 16;
constexpr float kCropScale = 1.5F;  ///< size of a crop over the extent of the landmarks in it
constexpr float kFeaturesPerPixel = static_cast<float>(kFeatureSide) / kInputSide;
constexpr int kIrisPoints = 5;
constexpr int kIrises = 2;

/// Where the graph is cut for one part.
struct Cut {
  int features = -1;  ///< tensor that is cropped
  int crop = -1;      ///< what the head sees
  int points = -1;    ///< what it says, in quarters of the crop's pixels
};

/// Finds the graph's own operators by following its outputs upstream.
class Attention {
 public:
  Attention(const TfliteModel& model, const std::string& name) : model_(model), name_(name) {}

  int output(std::string_view tensor_name) const {
    const auto found = std::find_if(model_.outputs.begin(), model_.outputs.end(), [&](int index) {
      return model_.tensors[static_cast<std::size_t>(index)].name == tensor_name;
    });
    return found == model_.outputs.end() ? fail() : *found;
  }

  /// The way of a part: features and matrix -> TransformTensorBilinear -> crop -> head -> points -> Reshape;
  /// with the scaled matrix -> TransformLandmarks -> Reshape -> output.
  Cut cut(std::string_view output_name) const {
    const TfliteOperator& placed = producer(producer(output(output_name)).inputs.at(0));
    if (placed.custom_name != "TransformLandmarks" || placed.inputs.size() != 2) {
      fail();
    }
    Cut cut;
    cut.points = producer(placed.inputs[0]).inputs.at(0);
    const int matrix = producer(placed.inputs[1]).inputs.at(0);
    for (const TfliteOperator& op : model_.operators) {
      if (op.custom_name == "TransformTensorBilinear" && op.inputs.size() == 2 && op.inputs[1] == matrix) {
        cut.features = op.inputs[0];
        cut.crop = op.outputs.at(0);
      }
    }
    return cut.crop < 0 ? throw error() : cut;
  }

  /// The tensor that the graph's first look hands to an output through a slice of everything.
  int before(std::string_view output_name) const { return producer(output(output_name)).inputs[0]; }

  [[noreturn]] int fail() const { throw error(); }

 private:
  Error error() const {
    return {ErrorKind::UnreadableInput, name_ + ": not the face mesh net with attention"};
  }

  const TfliteOperator& producer(int tensor) const {
    const auto found = std::find_if(model_.operators.begin(), model_.operators.end(), [&](const auto& op) {
      return op.outputs.size() == 1 && op.outputs[0] == tensor && !op.inputs.empty() && op.inputs[0] >= 0;
    });
    return found == model_.operators.end() ? throw error() : *found;
  }

  const TfliteModel& model_;
  const std::string& name_;
};

/// Bilinear samples at the centres of the crop's pixels; 0 beyond the features' outermost pixel centres.
///
/// origin, right_step, down_step  of the crop in features' pixels, measured from the features' corner
/// features                       [rows][columns][channels]
/// crop                           [channels][rows][columns] out
void crop_features(const Eigen::Vector2f& origin, const Eigen::Vector2f& right_step,
                   const Eigen::Vector2f& down_step, std::span<const float> features, std::span<float> crop) {
  constexpr float kLast = kFeatureSide - 1;
  constexpr std::size_t kPlane = std::size_t{kCropSide} * kCropSide;
  std::fill(crop.begin(), crop.end(), 0.0F);
  for (int y = 0; y < kCropSide; ++y) {
    for (int x = 0; x < kCropSide; ++x) {
      const Eigen::Vector2f at = origin + (static_cast<float>(x) + 0.5F) * right_step +
                                 (static_cast<float>(y) + 0.5F) * down_step - Eigen::Vector2f(0.5F, 0.5F);
      if (!(at.minCoeff() >= 0 && at.maxCoeff() <= kLast)) {
        continue;
      }
      const int column = std::min(static_cast<int>(at.x()), kFeatureSide - 2);
      const int row = std::min(static_cast<int>(at.y()), kFeatureSide - 2);
      const float right = at.x() - static_cast<float>(column);
      const float down = at.y() - static_cast<float>(row);
      const float* corner =
          features.data() + static_cast<std::ptrdiff_t>(row * kFeatureSide + column) * kFeatureChannels;
      float* out = crop.data() + static_cast<std::ptrdiff_t>(y * kCropSide + x);
      for (std::ptrdiff_t c = 0; c < kFeatureChannels; ++c) {
        constexpr std::ptrdiff_t kBelow = std::ptrdiff_t{kFeatureSide} * kFeatureChannels;
        const float above = (1 - right) * corner[c] + right * corner[c + kFeatureChannels];
        const float below = (1 - right) * corner[c + kBelow] + right * corner[c + kBelow + kFeatureChannels];
        out[c * static_cast<std::ptrdiff_t>(kPlane)] = (1 - down) * above + down * below;
      }
    }
  }
}

Network make_trunk(const TfliteModel& model, const Attention& graph, const std::string& name) {
  if (model.inputs.size() != 1) {
    graph.fail();
  }
  Network trunk(part_of(model, model.inputs[0],
                        {graph.before("output_mesh_identity"), graph.cut("output_lips").features,
                         graph.output("conv_faceflag")},
                        name),
                name);
  if (trunk.input_rows() != kInputSide || trunk.input_columns() != kInputSide ||
      trunk.output(0).size() != std::size_t{3} * landmark_count ||
      trunk.output(1).size() != std::size_t{kFeatureSide} * kFeatureSide * kFeatureChannels ||
      trunk.output(2).size() != 1) {
    graph.fail();
  }
  return trunk;
}

}  // namespace

AttentionNet::AttentionNet(std::span<const std::uint8_t> tflite, const std::string& name)
    : AttentionNet(parse_tflite(tflite, name), name) {}

AttentionNet::AttentionNet(const TfliteModel& model, const std::string& name)
    : trunk_(make_trunk(model, Attention(model, name), name)) {
  const Attention graph(model, name);
  // The graph's "left" is the image's.
  const auto add = [&](std::string_view points, std::string_view iris, std::span<const int> landmarks,
                       std::array<int, 2> corners, Eigen::Index iris_column) {
    const Cut cut = graph.cut(points);
    std::vector<int> outputs = {cut.points};
    if (iris_column >= 0) {
      outputs.push_back(graph.cut(iris).points);
    }
    Part part{Network(part_of(model, cut.crop, outputs, name), name, kFeatureChannels), landmarks, corners,
              iris_column};
    if (part.head.input_rows() != kCropSide || part.head.input_columns() != kCropSide ||
        part.head.output(0).size() != 2 * landmarks.size() ||
        (iris_column >= 0 && part.head.output(1).size() != std::size_t{2} * kIrisPoints)) {
      graph.fail();
    }
    parts_.push_back(std::move(part));
  };
  add("output_lips", {}, lip_landmarks(), {61, 291}, -1);
  add("output_left_eye", "output_left_iris", right_eye_landmarks(), {33, 133}, 0);
  add("output_right_eye", "output_right_iris", left_eye_landmarks(), {362, 263}, 1);
}

void AttentionNet::look_closer(Part& part) {
  // The crop is the box round the part's landmarks, its axes along the line through the two corners:
  // feature = origin + right x + down y, for (x, y) in pixels of the crop from its corner on.
  const Eigen::Matrix2Xf& first = first_look_;
  const Eigen::Vector2f along = first.col(part.corners[1]) - first.col(part.corners[0]);
  const float angle = std::atan2(along.y(), along.x());
  const Eigen::Vector2f right(std::cos(angle), std::sin(angle));
  const Eigen::Vector2f down(-right.y(), right.x());
  Eigen::Array2f low = Eigen::Array2f::Constant(std::numeric_limits<float>::max());
  Eigen::Array2f high = -low;
  for (const int landmark : part.landmarks) {
    const Eigen::Array2f at(first.col(landmark).dot(right), first.col(landmark).dot(down));
    low = low.min(at);
    high = high.max(at);
  }
  const Eigen::Array2f middle = 0.5F * kFeaturesPerPixel * (low + high);
  const Eigen::Array2f step = kCropScale * kFeaturesPerPixel / kCropSide * (high - low);
  const Eigen::Vector2f right_step = step.x() * right;
  const Eigen::Vector2f down_step = step.y() * down;
  const Eigen::Vector2f origin =
      middle.x() * right + middle.y() * down - 0.5F * kCropSide * (right_step + down_step);

  crop_features(origin, right_step, down_step, trunk_.output(1), part.head.input());
  part.head.forward();

  // A head's points are in quarters of the crop's pixels.
  Eigen::Matrix2f net_from_head;
  net_from_head << right_step, down_step;
  const auto place = [&](const Eigen::Vector2f& point) -> Eigen::Vector2f {
    return origin / kFeaturesPerPixel + net_from_head * point;
  };
  const Eigen::Map<const Eigen::Matrix2Xf> points(part.head.output(0).data(), 2,
                                                  static_cast<Eigen::Index>(part.landmarks.size()));
  for (std::size_t i = 0; i < part.landmarks.size(); ++i) {
    refined_.col(part.landmarks[i]).head<2>() = place(points.col(static_cast<Eigen::Index>(i)));
  }
  if (part.iris >= 0) {
    // The centre comes first, then four points of the edge.
    const Eigen::Map<const Eigen::Vector2f> centre(part.head.output(1).data());
    irises_.col(part.iris).head<2>() = place(centre);
  }
}

float AttentionNet::find(const FacePicture& picture, Eigen::Matrix3Xf& points_px,
                         Eigen::Matrix3Xf& irises_px) {
  std::ranges::copy(picture.values(), trunk_.input().begin());
  trunk_.forward();
  refined_ = Eigen::Map<const Eigen::Matrix3Xf>(trunk_.output(0).data(), 3, landmark_count);
  first_look_ = refined_.topRows<2>();
  irises_.setZero(3, kIrises);
  for (Part& part : parts_) {
    look_closer(part);
  }
  picture.window().image_from_net(refined_, kInputSide, points_px);
  picture.window().image_from_net(irises_, kInputSide, irises_px);
  return 1 / (1 + std::exp(-trunk_.output(2)[0]));
}

}  // namespace facet::landmark
