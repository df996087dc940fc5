#include "person/chart_flow.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "maths/statistics.hpp"
#include "person/chart_view.hpp"
#include "person/skin_registration.hpp"

namespace facet::person {
namespace {

constexpr double kAlikeMm = 12;  ///< over which skin moves alike
constexpr double kApartMm2 = 6;  ///< of skin, that says one thing: deviations are alike within their window
constexpr double kBlurTexels = 0.7;
constexpr double kAgreementMm = 2;
constexpr double kLeastScale = 0.5;
constexpr float kBound = 2;      ///< scales, from which on a residual loses its say
constexpr float kShown = 0.25F;  ///< a texel's weight, for the scale
constexpr std::size_t kFewest = 100;
constexpr int kNode = 4;  ///< texels from one node of the flow to the next
constexpr int kSteps = 4;
constexpr int kSweeps = 20;
constexpr float kOverrelaxed = 1.3F;
constexpr double kLeastContrast = 0.05;

/// The normal equations of a frame's texels at the flow's nodes.
struct NodeSums {
  cv::Mat xx, xy, yy, x, y;
};

cv::Mat slope(const cv::Mat& image, int x, int y) {
  cv::Mat out;
  cv::Sobel(image, out, CV_32F, x, y, 3, 1.0 / 8);
  return out;
}

double scale_of(const cv::Mat& residual, const cv::Mat& weight) {
  std::vector<double> sizes;
  sizes.reserve(residual.total());
  for (std::size_t t = 0; t < residual.total(); ++t) {
    if (weight.ptr<float>()[t] > kShown) {
      sizes.push_back(std::abs(static_cast<double>(residual.ptr<float>()[t])));
    }
  }
  return sizes.size() < kFewest ? 0 : std::max(kLeastScale, 1.4826 * maths::median_of(std::move(sizes)));
}

NodeSums sums_at_nodes(const cv::Mat& gradient_x, const cv::Mat& gradient_y, const cv::Mat& residual,
                       const cv::Mat& weight, const std::array<cv::Mat, 2>& step, double scale) {
  std::array<cv::Mat, 5> each;
  for (cv::Mat& sum : each) {
    sum.create(residual.size(), CV_32F);
  }
  for (std::size_t t = 0; t < residual.total(); ++t) {
    const float e = residual.ptr<float>()[t];
    const float q = e / (kBound * static_cast<float>(scale));
    const float w = weight.ptr<float>()[t] / ((1 + q * q) * (1 + q * q));
    const float gx = gradient_x.ptr<float>()[t];
    const float gy = gradient_y.ptr<float>()[t];
    const float wanted = gx * step[0].ptr<float>()[t] + gy * step[1].ptr<float>()[t] - e;
    each[0].ptr<float>()[t] = w * gx * gx;
    each[1].ptr<float>()[t] = w * gx * gy;
    each[2].ptr<float>()[t] = w * gy * gy;
    each[3].ptr<float>()[t] = w * gx * wanted;
    each[4].ptr<float>()[t] = w * gy * wanted;
  }
  const cv::Size nodes((residual.cols + kNode - 1) / kNode, (residual.rows + kNode - 1) / kNode);
  for (cv::Mat& sum : each) {
    cv::resize(sum, sum, nodes, 0, 0, cv::INTER_AREA);
    sum *= kNode * kNode;
  }
  return {each[0], each[1], each[2], each[3], each[4]};
}

/// Solves (sums + stays + alike neighbours) u = right by sweeps over the nodes, there and back.
void relax(const NodeSums& sums, float stays, float alike, std::array<cv::Mat, 2>& u) {
  const int width = u[0].cols;
  const int height = u[0].rows;
  const auto visit = [&](int row, int column) {
    float around_x = 0;
    float around_y = 0;
    float count = 0;
    const auto add = [&](int r, int c) {
      if (r >= 0 && r < height && c >= 0 && c < width) {
        around_x += u[0].at<float>(r, c);
        around_y += u[1].at<float>(r, c);
        ++count;
      }
    };
    add(row - 1, column);
    add(row + 1, column);
    add(row, column - 1);
    add(row, column + 1);
    const float held = stays + alike * count;
    const float xx = sums.xx.at<float>(row, column) + held;
    const float xy = sums.xy.at<float>(row, column);
    const float yy = sums.yy.at<float>(row, column) + held;
    const float x = sums.x.at<float>(row, column) + alike * around_x;
    const float y = sums.y.at<float>(row, column) + alike * around_y;
    const float determinant = xx * yy - xy * xy;
    float& ux = u[0].at<float>(row, column);
    float& uy = u[1].at<float>(row, column);
    ux += kOverrelaxed * ((yy * x - xy * y) / determinant - ux);
    uy += kOverrelaxed * ((xx * y - xy * x) / determinant - uy);
  };
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int i = 0; i < width * height; ++i) {
      const int node = sweep % 2 == 0 ? i : width * height - 1 - i;
      visit(node / width, node % width);
    }
  }
}

/// Weighted correlation of two charts around each texel, where there is something to correlate.
cv::Mat agreement_of(const cv::Mat& reference, const cv::Mat& shown, const cv::Mat& weight, double sigma) {
  const cv::Mat both = blurred(weight.mul(reference).mul(shown), sigma);
  const cv::Mat one = blurred(weight.mul(reference).mul(reference), sigma);
  const cv::Mat other = blurred(weight.mul(shown).mul(shown), sigma);
  cv::Mat size;
  cv::sqrt(one.mul(other), size);
  return cv::min(cv::max(both / (size + kLeastContrast), 0), 1);
}

}  // namespace

ChartFlow flow_on_chart(const cv::Mat& reference, const cv::Mat& shown, const cv::Mat& weight,
                        double texel_mm, double usual_mm) {
  ChartFlow out;
  out.step = {cv::Mat::zeros(reference.size(), CV_32F), cv::Mat::zeros(reference.size(), CV_32F)};
  cv::Mat from;
  cv::Mat to;
  cv::GaussianBlur(reference, from, {}, kBlurTexels);
  cv::GaussianBlur(shown, to, {}, kBlurTexels);
  const cv::Size nodes((reference.cols + kNode - 1) / kNode, (reference.rows + kNode - 1) / kNode);
  std::array<cv::Mat, 2> at_nodes{cv::Mat::zeros(nodes, CV_32F), cv::Mat::zeros(nodes, CV_32F)};
  const cv::Mat from_x = slope(from, 1, 0);
  const cv::Mat from_y = slope(from, 0, 1);
  // Both terms of the prior in units of a texel's data: usual_mm squared over patches of kAlikeMm.
  const double prior = kApartMm2 / (usual_mm * usual_mm * std::numbers::pi);
  for (int k = 0; k < kSteps; ++k) {
    const cv::Mat there = moved(to, out.step);
    const cv::Mat counts = weight.mul(moved(weight, out.step));
    const cv::Mat residual = there - from;
    const double scale = scale_of(residual, counts);
    if (!(scale > 0)) {
      break;
    }
    const NodeSums sums = sums_at_nodes((from_x + slope(there, 1, 0)) / 2, (from_y + slope(there, 0, 1)) / 2,
                                        residual, counts, out.step, scale);
    const double alike = scale * scale * prior;
    const double node_mm = kNode * texel_mm;
    relax(sums, static_cast<float>(alike * node_mm * node_mm / (kAlikeMm * kAlikeMm)),
          static_cast<float>(alike), at_nodes);
    for (std::size_t i = 0; i < 2; ++i) {
      cv::resize(at_nodes[i], out.step[i], reference.size(), 0, 0, cv::INTER_LINEAR);
    }
  }
  out.agreement =
      agreement_of(from, moved(to, out.step), weight.mul(moved(weight, out.step)), kAgreementMm / texel_mm);
  return out;
}

}  // namespace facet::person
