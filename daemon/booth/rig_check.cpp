#include "booth/rig_check.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <utility>

namespace facet::booth {
namespace {

constexpr int kCorners = 150;
constexpr double kCornerQuality = 0.02;
constexpr double kCornerDistance_px = 8;
constexpr int kHalfWindow_px = 8;
/// How far beside the line of sight a corner is looked for: a camera turned by this was bumped badly.
constexpr double kReach_degrees = 1;
constexpr double kLeastCorrelation = 0.85;
/// The second best place, beyond a window's half, must be worse by this.
constexpr double kUniqueness = 0.05;
constexpr std::size_t kEnoughMatches = 80;
constexpr int kMostSlots = 12;

cv::Mat grey_of(const Frame& frame) {
  const cv::Mat rgba(frame.height_px, frame.width_px, CV_8UC4, const_cast<std::uint8_t*>(frame.pixels.get()),
                     frame.stride_bytes);
  cv::Mat grey;
  cv::cvtColor(rgba, grey, cv::COLOR_RGBA2GRAY);
  return grey;
}

/// Offset of a parabola's top through three values at -1, 0, 1; 0 where there is none.
double top_of(double before, double at, double after) {
  const double bend = before - 2 * at + after;
  return bend < 0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0;
}

/// Where in the right picture a left pixel can be: around the line that it draws there between the depths.
std::optional<cv::Rect> search_area(const capture::Lens& left, const capture::Lens& right,
                                    const Eigen::Vector2d& pixel, const stereo::DepthRange& depths) {
  const auto direction = left.direction(pixel);
  if (!direction) {
    return std::nullopt;
  }
  const double reach_px = kHalfWindow_px + right.fx_px * std::tan(kReach_degrees * M_PI / 180);
  Eigen::AlignedBox2d box;
  for (const float depth : {depths.nearest_mm, depths.farthest_mm}) {
    const auto at = right.project(left.camera_from_rig.inverse() * (static_cast<double>(depth) * *direction));
    if (!at) {
      return std::nullopt;
    }
    box.extend(*at);
  }
  const Eigen::Vector2d low = box.min().array() - reach_px;
  const Eigen::Vector2d high = box.max().array() + reach_px;
  const cv::Rect area(static_cast<int>(low.x()), static_cast<int>(low.y()),
                      static_cast<int>(high.x() - low.x()), static_cast<int>(high.y() - low.y()));
  const cv::Rect seen = area & cv::Rect(0, 0, right.width_px, right.height_px);
  constexpr int kWindow_px = 2 * kHalfWindow_px + 1;
  return seen.width > kWindow_px + 2 && seen.height > kWindow_px + 2 ? std::optional(seen) : std::nullopt;
}

}  // namespace

std::vector<capture::PointMatch> match_corners(const capture::Lens& left, const capture::Lens& right,
                                               const Frame& left_picture, const Frame& right_picture,
                                               const stereo::DepthRange& depths) {
  std::vector<capture::PointMatch> matches;
  if (left_picture.empty() || right_picture.empty() || left_picture.corrupt || right_picture.corrupt ||
      right_picture.width_px != right.width_px || right_picture.height_px != right.height_px) {
    return matches;
  }
  const cv::Mat from = grey_of(left_picture);
  const cv::Mat to = grey_of(right_picture);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(from, corners, kCorners, kCornerQuality, kCornerDistance_px);
  cv::Mat scores;
  for (const cv::Point2f& corner : corners) {
    const cv::Point centre(static_cast<int>(std::lround(corner.x)), static_cast<int>(std::lround(corner.y)));
    const cv::Rect window(centre.x - kHalfWindow_px, centre.y - kHalfWindow_px, 2 * kHalfWindow_px + 1,
                          2 * kHalfWindow_px + 1);
    const auto area = search_area(left, right, {centre.x, centre.y}, depths);
    if (!area || (window & cv::Rect(0, 0, from.cols, from.rows)) != window) {
      continue;
    }
    cv::matchTemplate(to(*area), from(window), scores, cv::TM_CCOEFF_NORMED);
    double best = 0;
    cv::Point at;
    cv::minMaxLoc(scores, nullptr, &best, nullptr, &at);
    if (!(best > kLeastCorrelation) || at.x == 0 || at.y == 0 || at.x == scores.cols - 1 ||
        at.y == scores.rows - 1) {
      continue;
    }
    const auto score = [&](int dx, int dy) {
      return static_cast<double>(scores.at<float>(at.y + dy, at.x + dx));
    };
    const Eigen::Vector2d found(area->x + at.x + kHalfWindow_px + top_of(score(-1, 0), best, score(1, 0)),
                                area->y + at.y + kHalfWindow_px + top_of(score(0, -1), best, score(0, 1)));
    cv::rectangle(scores,
                  cv::Rect(at.x - kHalfWindow_px / 2, at.y - kHalfWindow_px / 2, kHalfWindow_px + 1,
                           kHalfWindow_px + 1),
                  cv::Scalar(-1), cv::FILLED);
    double second = 0;
    cv::minMaxLoc(scores, nullptr, &second);
    if (best - second > kUniqueness) {
      matches.push_back({{centre.x, centre.y}, found});
    }
  }
  return matches;
}

RigCheck::RigCheck(std::shared_ptr<const capture::Rig> rig, const stereo::DepthRange& depths)
    : rig_(std::move(rig)), depths_(depths), pairs_(rig_->pairs.size()), known_(rig_->pairs.size()) {
  for (std::size_t i = 0; i < known_.size(); ++i) {
    known_[i].left = rig_->cameras[rig_->pairs[i].left].name;
    known_[i].right = rig_->cameras[rig_->pairs[i].right].name;
  }
}

void RigCheck::judge(Pair& pair, RigPairStatus& known) const {
  const capture::RigCamera& left = rig_->cameras[rig_->pairs[next_].left];
  const capture::RigCamera& right = rig_->cameras[rig_->pairs[next_].right];
  const capture::PairCheck check = capture::check_pair(left, right, pair.matches);
  if (check.verdict == capture::PairVerdict::TooFewMatches) {
    return;
  }
  known.wrong = check.verdict == capture::PairVerdict::Fine ? std::string() : check.message;
  known.matches = check.matches;
  known.median_px = check.median_px;
  known.p95_px = check.p95_px;
  const double most_px = 5 * capture::PairCheckOptions().most_median_px;
  std::array<int, std::tuple_size_v<decltype(RigPairStatus::error_px)>> counts{};
  known.error_px.fill(0);
  for (const capture::PointMatch& match : pair.matches) {
    const auto error_px = capture::epipolar_error_px(left.lens, right.lens, match);
    const auto part = [](double at_px, int size_px, int parts) {
      return std::clamp(static_cast<int>(at_px / size_px * parts), 0, parts - 1);
    };
    // A camera that was moved misses everywhere; where the pair is fine, what misses by far is a wrong match.
    if (error_px && (std::abs(*error_px) < most_px || !known.wrong.empty())) {
      const auto cell = static_cast<std::size_t>(
          part(match.left_px.y(), left.lens.height_px, RigPairStatus::kRows) * RigPairStatus::kColumns +
          part(match.left_px.x(), left.lens.width_px, RigPairStatus::kColumns));
      known.error_px.at(cell) += static_cast<float>(std::abs(*error_px));
      ++counts.at(cell);
    }
  }
  for (std::size_t cell = 0; cell < counts.size(); ++cell) {
    known.error_px.at(cell) =
        counts.at(cell) > 0 ? known.error_px.at(cell) / static_cast<float>(counts.at(cell)) : -1.0F;
  }
}

std::string RigCheck::look(const FrameSet& set) {
  Pair& pair = pairs_[next_];
  const capture::RigCamera& left = rig_->cameras[rig_->pairs[next_].left];
  const capture::RigCamera& right = rig_->cameras[rig_->pairs[next_].right];
  const auto found = match_corners(left.lens, right.lens, set.frames.at(rig_->pairs[next_].left),
                                   set.frames.at(rig_->pairs[next_].right), depths_);
  pair.matches.insert(pair.matches.end(), found.begin(), found.end());
  ++pair.slots;
  if (pair.matches.size() >= kEnoughMatches || pair.slots >= kMostSlots) {
    judge(pair, known_[next_]);
    pair = {};
  }
  next_ = (next_ + 1) % pairs_.size();
  for (const RigPairStatus& one : known_) {
    if (!one.wrong.empty()) {
      return one.wrong;
    }
  }
  return {};
}

}  // namespace facet::booth
