#include "calibration/exchange.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/core.hpp>

#include "facet/error.hpp"
#include "support/board_views.hpp"
#include "support/paths.hpp"

namespace facet::calibration {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

template <typename Work>
std::string error_of(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

void expect_near(const capture::Lens& a, const capture::Lens& b) {
  EXPECT_EQ(a.width_px, b.width_px);
  EXPECT_EQ(a.height_px, b.height_px);
  EXPECT_EQ(a.fx_px, b.fx_px);
  EXPECT_EQ(a.cy_px, b.cy_px);
  EXPECT_EQ(a.distortion.k1, b.distortion.k1);
  EXPECT_EQ(a.distortion.p2, b.distortion.p2);
}

/// OpenCV reads what is written, and what OpenCV's stereo_calib sample writes is read.
TEST(Exchange, OpenCvReadsAndWritesTheSame) {
  const test::TemporaryFolder folder;
  const capture::Rig rig = booth_rig(1);
  const OpenCvTexts texts = format_opencv(rig, {2, 3});
  cv::FileStorage lenses(texts.intrinsics, cv::FileStorage::READ | cv::FileStorage::MEMORY);
  cv::FileStorage poses(texts.extrinsics, cv::FileStorage::READ | cv::FileStorage::MEMORY);
  cv::Mat m1;
  cv::Mat d1;
  cv::Mat m2;
  cv::Mat d2;
  cv::Mat r;
  cv::Mat t;
  lenses["M1"] >> m1;
  lenses["D1"] >> d1;
  lenses["M2"] >> m2;
  lenses["D2"] >> d2;
  poses["R"] >> r;
  poses["T"] >> t;
  EXPECT_EQ(m1.at<double>(0, 0), rig.cameras[2].lens.fx_px);
  EXPECT_EQ(d2.at<double>(0, 3), rig.cameras[3].lens.distortion.p2);
  const Eigen::Isometry3d right_from_left =
      rig.cameras[3].lens.camera_from_rig * rig.cameras[2].lens.camera_from_rig.inverse();
  EXPECT_EQ(t.at<double>(0, 0), right_from_left.translation().x());

  const std::string intrinsics = (folder.path() / "intrinsics.yml").string();
  const std::string extrinsics = (folder.path() / "extrinsics.yml").string();
  {
    cv::FileStorage lens_file(intrinsics, cv::FileStorage::WRITE);
    lens_file << "M1" << m1 << "D1" << d1 << "M2" << m2 << "D2" << d2;
    cv::FileStorage pose_file(extrinsics, cv::FileStorage::WRITE);
    pose_file << "R" << r << "T" << t;
  }
  EXPECT_THAT(error_of([&] { read_any_rig(intrinsics, extrinsics, {}); }), HasSubstr("--size"));
  const capture::Rig back = read_any_rig(intrinsics, extrinsics, {.width_px = 640, .height_px = 480});
  expect_near(back.cameras[0].lens, rig.cameras[2].lens);
  expect_near(back.cameras[1].lens, rig.cameras[3].lens);
  EXPECT_LT((back.cameras[1].lens.camera_from_rig.matrix() - right_from_left.matrix()).norm(), 1e-12);
  ASSERT_EQ(back.pairs.size(), 1U);
  EXPECT_EQ(back.cameras[back.pairs[0].right].name, "right");
  EXPECT_THAT(error_of([&] { read_any_rig(intrinsics, {}, {.width_px = 640, .height_px = 480}); }),
              HasSubstr("--extrinsics"));
  // Our own has the size in it; metres on request.
  const capture::Rig own =
      parse_opencv(texts.intrinsics, "i.yml", texts.extrinsics, "e.yml", {.unit_mm = 1000});
  EXPECT_EQ(own.cameras[0].lens.width_px, 640);
  EXPECT_DOUBLE_EQ(own.cameras[1].lens.camera_from_rig.translation().x(), 1000 * t.at<double>(0, 0));
}

TEST(Exchange, OpenCvErrorsNameFileLineAndKey) {
  const OpenCvTexts texts = format_opencv(booth_rig(1), {0, 1});
  const auto error = [&](const std::string& intrinsics, const std::string& extrinsics) {
    return error_of([&] { parse_opencv(intrinsics, "in.yml", extrinsics, "ex.yml", {}); });
  };
  EXPECT_EQ(error(texts.intrinsics, texts.extrinsics), "no error");
  EXPECT_THAT(error("", texts.extrinsics), HasSubstr("in.yml"));
  EXPECT_THAT(error("a: [1", texts.extrinsics), HasSubstr("in.yml:1: not valid YAML"));
  EXPECT_THAT(error(replaced(texts.intrinsics, "M2", "M3"), texts.extrinsics), HasSubstr("M2: is missing"));
  EXPECT_THAT(error(texts.intrinsics, replaced(texts.extrinsics, "rows: 3", "rows: 4")),
              AllOf(HasSubstr("ex.yml:"), HasSubstr("R: has 9 numbers, not 4 x 3")));
  EXPECT_THAT(error(texts.intrinsics, replaced(texts.extrinsics, "data: [ 9", "data: [ 7")),
              HasSubstr("R: is no rotation"));
  const std::string rational =
      "D1: { rows: 1, cols: 8, dt: d, data: [ 0.1, 0., 0., 0., 0., 0.2, 0., 0. ] }\nunused1";
  EXPECT_THAT(error(replaced(texts.intrinsics, "D1", rational), texts.extrinsics), HasSubstr("rational"));
  EXPECT_THAT(error(replaced(texts.intrinsics, "image_width: 640", "image_width: 64.5"), texts.extrinsics),
              HasSubstr("in.yml:3: image_width"));
}

TEST(Exchange, KalibrReadsBackWhatIsWritten) {
  const capture::Rig rig = booth_rig(2);
  const capture::Rig back = parse_kalibr(format_kalibr(rig), "camchain.yaml");
  ASSERT_EQ(back.cameras.size(), rig.cameras.size());
  const Eigen::Isometry3d cam0_from_rig = rig.cameras[0].lens.camera_from_rig;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    expect_near(back.cameras[i].lens, rig.cameras[i].lens);
    const Eigen::Isometry3d expected = rig.cameras[i].lens.camera_from_rig * cam0_from_rig.inverse();
    EXPECT_LT((back.cameras[i].lens.camera_from_rig.matrix() - expected.matrix()).norm(), 1e-9) << i;
  }
}

/// As Kalibr itself writes it.
constexpr const char* kCamchain = R"(cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.294719325148729, 0.08601391290708914, -0.0003238494917967103, -0.00041999959826033857]
  distortion_model: radtan
  intrinsics: [461.487246372674, 460.1113992557959, 356.39105303227853, 231.15719697054647]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.9999974202424761, -0.0006061644042374658, -0.0021888015443580716, -0.10997985330860003]
  - [0.0005966506534117, 0.9999903820101012, -0.0043446051041388, 0.0003991215870135]
  - [0.0021914140049, 0.0043432876, 0.9999881666, -0.0008537026]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.2951, 0.0867, -0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [460.06, 458.86, 371.1, 229.6]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
)";

TEST(Exchange, KalibrsOwnFileIsRead) {
  const capture::Rig rig = parse_kalibr(kCamchain, "camchain.yaml");
  ASSERT_EQ(rig.cameras.size(), 2U);
  EXPECT_EQ(rig.cameras[0].lens.cx_px, 356.39105303227853);
  EXPECT_NEAR(rig.cameras[1].lens.camera_from_rig.translation().x(), -109.98, 0.01);
  ASSERT_EQ(rig.pairs.size(), 1U);
  EXPECT_EQ(rig.pairs[0].left, 0U);
}

TEST(Exchange, KalibrErrorsNameWhatIsNotKnown) {
  const auto error = [&](const std::string& from, const std::string& to) {
    return error_of([&] { parse_kalibr(replaced(kCamchain, from, to), "chain.yaml"); });
  };
  EXPECT_THAT(error("radtan", "equidistant"), AllOf(HasSubstr("chain.yaml:5: cam0.distortion_model"),
                                                    HasSubstr("'equidistant'"), HasSubstr("radtan")));
  EXPECT_THAT(error("pinhole", "omni"), HasSubstr("cam0.camera_model: 'omni'"));
  EXPECT_THAT(error("[752, 480]", "[752]"), HasSubstr("[width, height]"));
  EXPECT_THAT(error("  T_cn_cnm1:", "  T_cam_imu:"), HasSubstr("cam1.T_cn_cnm1: is missing"));
  EXPECT_THAT(error("[0.9999974202424761", "[0.9"), HasSubstr("cam1.T_cn_cnm1: is no rotation"));
  EXPECT_THAT(error("cam0:", "camera:"), HasSubstr("cam0: is missing"));
  EXPECT_THAT(error("[461.487246372674", "[.nan"), HasSubstr("must be a number"));
  EXPECT_THAT(error_of([] { parse_kalibr("- 1\n- 2\n", "chain.yaml"); }), HasSubstr("no keys"));
  capture::Rig k3 = booth_rig(2);
  k3.cameras[0].lens.distortion.k3 = 0.1;
  EXPECT_THAT(error_of([&] { format_kalibr(k3); }), HasSubstr("without --k3"));
}

TEST(Exchange, OtherFilesAreRefused) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "other.yaml") << "a: 1\n";
  EXPECT_THAT(error_of([&] { read_any_rig(folder.path() / "other.yaml", {}, {}); }),
              AllOf(HasSubstr("other.yaml"), HasSubstr("Kalibr")));
  EXPECT_THAT(error_of([&] { read_any_rig(folder.path() / "missing.yaml", {}, {}); }),
              HasSubstr("missing.yaml"));
}

TEST(Exchange, DepthAndLengthAreRefused) {
  const auto repeated = [](const std::string& text, std::size_t bytes) {
    std::string all;
    while (all.size() + text.size() <= bytes) {
      all += text;
    }
    return all;
  };
  for (const char* piece : {"[", "{", "- ", "? ", "[{", "[a: ", "&a [", "!a {", "- - ? "}) {
    const std::string text = repeated(piece, 100'000);
    EXPECT_THAT(error_of([&] { parse_kalibr(text, "chain.yaml"); }), HasSubstr("chain.yaml")) << piece;
    EXPECT_THAT(error_of([&] { parse_kalibr("cam0: " + text.substr(10), "chain.yaml"); }),
                HasSubstr("chain.yaml"))
        << piece;
    EXPECT_THAT(error_of([&] { parse_opencv(text, "lenses.yml", text, "poses.yml", {}); }),
                HasSubstr("lenses.yml"))
        << piece;
  }
  EXPECT_THAT(error_of([&] { parse_kalibr(std::string(kMaxYamlBytes + 1, ' '), "chain.yaml"); }),
              HasSubstr("more than 1048576 bytes"));
}

}  // namespace
}  // namespace facet::calibration
