#include "landmark/face_detector.hpp"

#include <algorithm>
#include <cmath>

#include "facet/error.hpp"

namespace facet::landmark {
namespace {

constexpr int input_side = 128;
constexpr std::size_t anchor_count = 896;
constexpr std::size_t values_per_anchor = 16;  ///< centre x, y, width, height, 6 key points x, y
constexpr float merge_overlap = 0.3F;          ///< intersection over union, as MediaPipe's graph sets it

/// Anchor centres of the 16 x 16 grid (2 each) and the 8 x 8 grid (6 each), row by row.
std::vector<Eigen::Vector2f> make_anchors() {
  std::vector<Eigen::Vector2f> anchors;
  anchors.reserve(anchor_count);
  for (const auto& [cells, each] : {std::pair{16, 2}, std::pair{8, 6}}) {
    for (int y = 0; y < cells; ++y) {
      for (int x = 0; x < cells; ++x) {
        const Eigen::Vector2f centre =
            (Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)).array() + 0.5F) /
            static_cast<float>(cells);
        anchors.insert(anchors.end(), static_cast<std::size_t>(each), centre);
      }
    }
  }
  return anchors;
}

/// Of two squares with parallel sides; both come from one window, so its rotation does not matter.
float overlap(const Detection& a, const Detection& b, const Region& window) {
  const Eigen::Vector2f between = a.centre_px - b.centre_px;
  const Eigen::Vector2f apart{std::abs(between.dot(window.right())), std::abs(between.dot(window.down()))};
  const Eigen::Array2f shared =
      (0.5F * (a.size_px + b.size_px) - apart.array()).min(std::min(a.size_px, b.size_px)).max(0.0F);
  const float intersection = shared.prod();
  return intersection / (a.size_px * a.size_px + b.size_px * b.size_px - intersection);
}

Region turned_window(const Detection& face, float scale) {
  const Eigen::Vector2f eyes = face.points_px[Detection::LeftEye] - face.points_px[Detection::RightEye];
  return {face.centre_px, face.size_px * scale, std::atan2(eyes.y(), eyes.x())};
}

void accumulate(Detection& sum, const Detection& face) {
  sum.centre_px += face.score * face.centre_px;
  sum.size_px += face.score * face.size_px;
  for (std::size_t k = 0; k < sum.points_px.size(); ++k) {
    sum.points_px[k] += face.score * face.points_px[k];
  }
  sum.score += face.score;
}

void divide(Detection& sum, float score) {
  sum.centre_px /= sum.score;
  sum.size_px /= sum.score;
  for (Eigen::Vector2f& point : sum.points_px) {
    point /= sum.score;
  }
  sum.score = score;
}

}  // namespace

Region Detection::face_region() const {
  return turned_window(*this, face_window_scale);
}
Region Detection::second_look() const {
  return turned_window(*this, second_look_scale);
}

std::span<const Detection>::iterator nearest_to(const Eigen::Vector2f& place_px,
                                                std::span<const Detection> faces) {
  return std::min_element(faces.begin(), faces.end(), [&](const Detection& a, const Detection& b) {
    return (a.centre_px - place_px).squaredNorm() < (b.centre_px - place_px).squaredNorm();
  });
}

FaceDetector::FaceDetector(std::span<const std::uint8_t> tflite, const std::string& name)
    : network_(parse_tflite(tflite, name), name), sampler_(input_side), anchors_(make_anchors()) {
  if (network_.input_rows() != input_side || network_.input_columns() != input_side ||
      network_.output_count() != 2 || network_.output(0).size() != anchor_count * values_per_anchor ||
      network_.output(1).size() != anchor_count) {
    throw Error(ErrorKind::UnreadableInput, name + ": not the short-range face detector");
  }
  candidates_.reserve(anchor_count);
  merged_.reserve(anchor_count);
}

std::span<const Detection> FaceDetector::detect(const Frame& frame, const Region& window, float min_score) {
  // The net was trained on values from -1 to 1 and black beyond the border.
  sampler_.sample(frame, window, Border::Black, 1 / 127.5F, -1.0F, network_.input());
  network_.forward();
  const std::span<const float> boxes = network_.output(0);
  const std::span<const float> logits = network_.output(1);

  candidates_.clear();
  const float min_logit = std::log(min_score / (1 - min_score));
  for (std::size_t a = 0; a < anchor_count; ++a) {
    if (!(logits[a] >= min_logit)) {
      continue;
    }
    const std::span<const float> box = boxes.subspan(a * values_per_anchor, values_per_anchor);
    const auto image_point = [&](std::size_t i) {
      return window.image_from_window(anchors_[a] + Eigen::Vector2f(box[i], box[i + 1]) / input_side);
    };
    Detection face;
    face.score = 1 / (1 + std::exp(-logits[a]));
    face.centre_px = image_point(0);
    face.size_px = std::max(box[2], box[3]) / input_side * window.size_px;
    for (std::size_t k = 0; k < face.points_px.size(); ++k) {
      face.points_px[k] = image_point(4 + 2 * k);
    }
    if (face.size_px > 0 && std::isfinite(face.size_px) && face.centre_px.allFinite()) {
      candidates_.push_back(face);
    }
  }
  std::sort(candidates_.begin(), candidates_.end(),
            [](const Detection& a, const Detection& b) { return a.score > b.score; });

  merged_.clear();
  while (!candidates_.empty()) {
    const Detection best = candidates_.front();
    Detection sum;
    sum.centre_px.setZero();
    sum.points_px.fill(Eigen::Vector2f::Zero());
    std::erase_if(candidates_, [&](const Detection& face) {
      const bool same_face = overlap(best, face, window) > merge_overlap;
      if (same_face) {
        accumulate(sum, face);
      }
      return same_face;
    });
    divide(sum, best.score);
    merged_.push_back(sum);
  }
  return merged_;
}

}  // namespace facet::landmark
