#include "person/skin_registration.hpp"

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "person/chart_view.hpp"

namespace facet::person {
namespace {

/// What is wider is shading that the lamps do not explain.
constexpr double kWindowMm = 3;
/// A flow is the mean of what is believed so far around.
constexpr double kSmoothMm = 1.5;
/// The flow is found on every so many-th texel: pictures are coarser than the chart.
constexpr int kCoarser = 2;
/// Of a coarse texel's, that have to be seen.
constexpr float kWhole = 0.99F;
constexpr float kDarkest = 0.01F;        ///< albedo, below which it is taken to be this
constexpr float kLeastContrast = 0.03F;  ///< of the logarithm
constexpr double kLeastWeight = 1e-4;
constexpr double kLeastConfidence = 1e-3;

cv::Mat coarse(const cv::Mat& image) {
  cv::Mat out;
  cv::resize(image, out, {(image.cols + kCoarser - 1) / kCoarser, (image.rows + kCoarser - 1) / kCoarser}, 0,
             0, cv::INTER_AREA);
  return out;
}

std::array<cv::Mat, 2> flow_between(const cv::Mat& from, const cv::Mat& to) {
  const cv::Ptr<cv::DISOpticalFlow> dis = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
  dis->setFinestScale(0);
  cv::Mat both;
  dis->calc(from, to, both);
  std::array<cv::Mat, 2> out;
  cv::split(both, out.data());
  return out;
}

/// A flow and, [height][width], how far it is believed: 1 where it comes back to where it began, 0 at
/// `trip_texels` from there.
struct BelievedFlow {
  std::array<cv::Mat, 2> step;  ///< x, y, texels
  cv::Mat confidence;
};

/// from, to  of deviations()
BelievedFlow flow_there_and_back(const cv::Mat& from, const cv::Mat& to, float trip_texels) {
  const cv::Mat earlier = as_bytes(from);
  const cv::Mat later = as_bytes(to);
  BelievedFlow out{flow_between(earlier, later), {}};
  const std::array<cv::Mat, 2> back = flow_between(later, earlier);
  cv::Mat trip;
  cv::magnitude(out.step[0] + moved(back[0], out.step), out.step[1] + moved(back[1], out.step), trip);
  out.confidence = cv::max(1 - trip / trip_texels, 0);
  out.confidence = out.confidence.mul(out.confidence);
  return out;
}

}  // namespace

cv::Mat moved(const cv::Mat& image, const std::array<cv::Mat, 2>& flow) {
  cv::Mat x(flow[0].size(), CV_32F);
  cv::Mat y(flow[0].size(), CV_32F);
  for (int row = 0; row < x.rows; ++row) {
    for (int column = 0; column < x.cols; ++column) {
      x.at<float>(row, column) = static_cast<float>(column) + flow[0].at<float>(row, column);
      y.at<float>(row, column) = static_cast<float>(row) + flow[1].at<float>(row, column);
    }
  }
  cv::Mat out;
  cv::remap(image, out, x, y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return out;
}

cv::Mat deviations(const cv::Mat& logs, const cv::Mat& shows, double sigma) {
  const cv::Mat around = blurred(shows, sigma) + kLeastWeight;
  cv::Mat out = logs - blurred(shows.mul(logs), sigma) / around;
  cv::Mat spread;
  cv::sqrt(blurred(shows.mul(out.mul(out)), sigma) / around, spread);
  out /= spread + kLeastContrast;
  out.setTo(0, shows == 0);
  return out;
}

SkinRegistration::SkinRegistration(const SkinTexels& texels, const Eigen::ArrayXf& albedo,
                                   const Eigen::ArrayXf& known)
    : texels_(texels) {
  cv::Mat shows;
  reference_ = deviations(albedo, known, shows);
}

/// shows  1 where the texture is known, else 0
cv::Mat SkinRegistration::deviations(const Eigen::ArrayXf& values, const Eigen::ArrayXf& weight,
                                     cv::Mat& shows) const {
  const double sigma = kWindowMm / texels_.texel_mm / kCoarser;
  const cv::Mat share = coarse(texels_.image(weight));
  const cv::Mat logs =
      coarse(texels_.image(weight * values.max(kDarkest).log())) / cv::max(share, kLeastWeight);
  shows = cv::Mat::zeros(share.size(), CV_32F);
  shows.setTo(1, share > kWhole);
  return person::deviations(logs, shows, sigma);
}

std::array<cv::Mat, 2> SkinRegistration::flow(const Eigen::ArrayXf& shown,
                                              const Eigen::ArrayXf& weight) const {
  cv::Mat shows;
  cv::Mat texture = deviations(shown, weight, shows);
  reference_.copyTo(texture, shows == 0);  // nothing is seen to move there
  auto [there, confidence] = flow_there_and_back(reference_, texture, 1.0F / kCoarser);
  confidence = confidence.mul(shows);
  const double sigma = kSmoothMm / texels_.texel_mm / kCoarser;
  const cv::Mat around = blurred(confidence, sigma) + kLeastConfidence;
  for (cv::Mat& step : there) {
    const cv::Mat smooth = kCoarser * blurred(confidence.mul(step), sigma) / around;
    cv::resize(smooth, step, {texels_.grid.width, texels_.grid.height}, 0, 0, cv::INTER_LINEAR);
  }
  return there;
}

}  // namespace facet::person
