#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>
#include <random>

#include "face/chunk_file.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::face {
namespace {

using ::testing::HasSubstr;

std::vector<std::byte> read_bytes(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  const std::vector<char> text((std::istreambuf_iterator<char>(in)), {});
  std::vector<std::byte> bytes(text.size());
  std::memcpy(bytes.data(), text.data(), text.size());
  return bytes;
}

std::vector<std::byte> saved_bytes(const FaceModel& model) {
  const test::TemporaryFolder folder;
  model.save(folder.path() / "m.facemodel");
  return read_bytes(folder.path() / "m.facemodel");
}

/// The message with which the bytes are refused; "" where they are read.
std::string refusal(const std::vector<std::byte>& bytes,
                    std::uint64_t max_core_values = FaceModel::kMaxCoreValues) {
  try {
    FaceModel::parse(bytes, "test bytes", max_core_values);
    return "";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_THAT(error.what(), HasSubstr("test bytes"));
    return error.what();
  }
}

void expect_same(const FaceModel& a, const FaceModel& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.control.quads, b.control.quads);
  EXPECT_EQ(a.control.texture_coordinates, b.control.texture_coordinates);
  EXPECT_EQ(a.control.refinable, b.control.refinable);
  EXPECT_EQ(a.regions, b.regions);
  EXPECT_EQ(a.expression_names, b.expression_names);
  EXPECT_EQ(a.expression_sigma, b.expression_sigma);
  EXPECT_EQ(a.mean_albedo, b.mean_albedo);
  ASSERT_EQ(a.landmarks.size(), b.landmarks.size());
  for (std::size_t i = 0; i < a.landmarks.size(); ++i) {
    EXPECT_EQ(a.landmarks[i].vertices, b.landmarks[i].vertices);
    for (std::size_t corner = 0; corner < 3; ++corner) {
      EXPECT_NEAR(a.landmarks[i].weights[corner], b.landmarks[i].weights[corner], 1e-5F);
    }
  }
  ASSERT_EQ(a.core_mm.size(), b.core_mm.size());
  float worst_mm = 0;
  for (std::size_t i = 0; i < a.core_mm.size(); ++i) {
    worst_mm = std::max(worst_mm, std::abs(a.core_mm[i] - b.core_mm[i]));
  }
  // Half a step: 1 micrometre, or the largest coordinate (105 mm) / 32767.
  EXPECT_LE(worst_mm, 0.5F * 105.0F / 32767.0F * 1.01F);
}

TEST(FaceModelFile, SavedModelReadsBack) {
  const FaceModel model = test::synthetic_model(13);
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "m.facemodel";
  model.save(file);
  expect_same(FaceModel::load(file), model);
  // No temporary file stays behind.
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
}

TEST(FaceModelFile, SavingALoadedModelChangesNothing) {
  const FaceModel once = FaceModel::parse(saved_bytes(test::synthetic_model(13)), "once");
  const FaceModel twice = FaceModel::parse(saved_bytes(once), "twice");
  float worst_mm = 0;
  for (std::size_t i = 0; i < once.core_mm.size(); ++i) {
    worst_mm = std::max(worst_mm, std::abs(once.core_mm[i] - twice.core_mm[i]));
  }
  EXPECT_LE(worst_mm, 1e-5F);  // rounding of 100 mm as float
}

TEST(FaceModelFile, ModelWithoutLandmarksReadsBack) {
  FaceModel model = test::synthetic_model(13);
  model.landmarks.clear();
  expect_same(FaceModel::parse(saved_bytes(model), "bytes"), model);
}

SkinChart small_skin() {
  SkinChart skin;
  skin.width = 3;
  skin.height = 2;
  skin.least = {0.25F, 0.5F};
  skin.texels_per_unit = 8;
  skin.relief_mm = {0, 0.001F, -0.25F, 1.5F, -2, 0.032F};
  skin.albedo = {0.5F, 0.4F, 0.3F, 0.1F,  0.05F, 0.02F, 0,    0,    0,
                 1,    1,    1,    0.25F, 0.2F,  0.15F, 0.5F, 0.4F, 0.3F};
  return skin;
}

TEST(FaceModelFile, SkinReadsBack) {
  FaceModel model = test::synthetic_model(13);
  model.skin = small_skin();
  const FaceModel read = FaceModel::parse(saved_bytes(model), "bytes");
  expect_same(read, model);
  EXPECT_EQ(read.skin.width, 3);
  EXPECT_EQ(read.skin.height, 2);
  EXPECT_EQ(read.skin.least, model.skin.least);
  EXPECT_EQ(read.skin.texels_per_unit, 8);
  ASSERT_EQ(read.skin.relief_mm.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_NEAR(read.skin.relief_mm[i], model.skin.relief_mm[i], 1e-6F);
  }
  ASSERT_EQ(read.skin.albedo.size(), 18U);
  for (std::size_t i = 0; i < 18; ++i) {
    EXPECT_NEAR(read.skin.albedo[i], model.skin.albedo[i], 0.004F);
  }
  EXPECT_EQ(read.skin.albedo[6], 0) << "what is not known stays so";
  model.skin.albedo.clear();
  EXPECT_TRUE(FaceModel::parse(saved_bytes(model), "bytes").skin.albedo.empty()) << "a relief alone";
}

TEST(FaceModelFile, SkinThatIsNoneIsRefused) {
  FaceModel model = test::synthetic_model(13);
  const auto refused = [&](auto&& damage) {
    model.skin = small_skin();
    damage(model.skin);
    const test::TemporaryFolder folder;
    EXPECT_THROW(model.save(folder.path() / "m.facemodel"), Error);
  };
  refused([](SkinChart& skin) { skin.width = 4; });
  refused([](SkinChart& skin) { skin.height = -1; });
  refused([](SkinChart& skin) { skin.texels_per_unit = 0; });
  refused([](SkinChart& skin) { skin.least.x() = std::numeric_limits<float>::infinity(); });
  refused([](SkinChart& skin) { skin.relief_mm[2] = std::numeric_limits<float>::quiet_NaN(); });
  refused([](SkinChart& skin) { skin.relief_mm[2] = 31; });
  refused([](SkinChart& skin) { skin.albedo.pop_back(); });
  refused([](SkinChart& skin) { skin.albedo[4] = 1.5F; });
  refused([](SkinChart& skin) { skin.albedo[4] = std::numeric_limits<float>::quiet_NaN(); });
}

/// Files whose chunks don't fit each other.
TEST(SkinChart, DamagedChunksAreRefused) {
  const auto refused = [](std::uint32_t width, std::uint32_t height, float scale, std::size_t grid_bytes,
                          std::optional<std::size_t> texels, std::optional<std::size_t> tones = {}) {
    constexpr ChunkFormat kFormat{{'T', 'E', 'S', 'T', 'S', 'K', 'I', 'N'}, 1, "skin", "none"};
    std::vector<std::byte> grid(20);
    const std::array<std::uint32_t, 2> size{width, height};
    const std::array<float, 3> place{0, 0, scale};
    std::memcpy(grid.data(), size.data(), sizeof size);
    std::memcpy(grid.data() + sizeof size, place.data(), sizeof place);
    grid.resize(grid_bytes);
    ChunkWriter writer(kFormat);
    if (!grid.empty()) {
      writer.add("SKIN", grid, false);
    }
    const std::vector<std::int16_t> relief(texels.value_or(0), 100);
    if (texels) {
      writer.add("RELI", bytes_of(relief.data(), relief.size()), true);
    }
    if (tones) {
      const std::vector<std::uint8_t> albedo(*tones, 100);
      writer.add("TONE", bytes_of(albedo.data(), albedo.size()), true);
    }
    const std::vector<std::byte> file = writer.file();
    try {
      read_skin(ChunkReader(file, "test", kFormat));
      return std::string();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return std::string(error.what());
    }
  };
  EXPECT_EQ(refused(3, 2, 8, 20, 6), "");
  EXPECT_EQ(refused(3, 2, 8, 20, 6, 18), "");
  EXPECT_THAT(refused(3, 2, 8, 20, 6, 17), HasSubstr("TONE"));
  EXPECT_THAT(refused(3, 2, 8, 0, std::nullopt, 18), HasSubstr("SKIN"));
  EXPECT_EQ(refused(0, 0, 0, 0, std::nullopt), "") << "no skin is none";
  EXPECT_THAT(refused(3, 2, 8, 19, 6), HasSubstr("SKIN"));
  EXPECT_THAT(refused(3, 2, 8, 20, 5), HasSubstr("RELI"));
  EXPECT_THAT(refused(3, 2, 8, 20, std::nullopt), HasSubstr("RELI"));
  EXPECT_THAT(refused(3, 2, 8, 0, 6), HasSubstr("SKIN"));
  EXPECT_THAT(refused(0, 2, 8, 20, 0), HasSubstr("0x2 texels"));
  EXPECT_THAT(refused(4294967295U, 2, 8, 20, 6), HasSubstr("texels"));
  EXPECT_THAT(refused(3, 2, 0, 20, 6), HasSubstr("nowhere"));
  EXPECT_THAT(refused(3, 2, std::numeric_limits<float>::quiet_NaN(), 20, 6), HasSubstr("nowhere"));
}

TEST(SkinChart, IsReadBetweenItsTexels) {
  mesh::TextureCoordinates at(2, 5);
  at.col(0) << 0.25F, 0.5F;             // the first texel
  at.col(1) << 0.25F + 0.5F / 8, 0.5F;  // between it and the next
  at.col(2) << 0.25F + 1.0F / 8, 0.5F + 0.25F / 8;
  at.col(3) << 0.2F, 0.5F;  // beside the chart
  at.col(4) << 0.3F, std::numeric_limits<float>::quiet_NaN();
  const std::vector<float> relief_mm = relief_at(small_skin(), at);
  EXPECT_NEAR(relief_mm[0], 0, 1e-6F);
  EXPECT_NEAR(relief_mm[1], 0.0005F, 1e-6F);
  EXPECT_NEAR(relief_mm[2], 0.75F * 0.001F + 0.25F * -2, 1e-5F);
  EXPECT_EQ(relief_mm[3], 0);
  EXPECT_EQ(relief_mm[4], 0);
}

TEST(SkinChart, TakesWhatAMeshOnItHasMore) {
  SkinChart chart;
  chart.width = chart.height = 11;
  chart.texels_per_unit = 10;
  chart.relief_mm.assign(121, 1);
  mesh::TextureCoordinates at(2, 5);
  at << 0, 0.8F, 0, 0.8F, 1,  //
      0, 0, 0.8F, 0.8F, 1;
  mesh::Triangles triangles(3, 3);
  triangles << 0, 1, 1,  //
      1, 3, 3,           //
      2, 2, 4;
  add_relief(triangles, at, {0, 0.8F, 0, 0.8F, 2 * kMostReliefMm}, chart);
  const auto relief_mm = [&](int x, int y) { return chart.relief_mm[static_cast<std::size_t>(11 * y + x)]; };
  EXPECT_NEAR(relief_mm(0, 0), 1, 1e-5F);
  EXPECT_NEAR(relief_mm(3, 5), 1.3F, 1e-5F) << "linear";
  EXPECT_NEAR(relief_mm(8, 4), 1.8F, 1e-5F) << "an edge counts once";
  EXPECT_EQ(relief_mm(2, 10), 1) << "where no triangle lies";
  EXPECT_EQ(relief_mm(10, 10), kMostReliefMm);
  const std::vector<float> before = chart.relief_mm;
  add_relief(triangles, at, std::vector<float>(5, 0), chart);
  EXPECT_EQ(chart.relief_mm, before);
}

/// What the chart does not know is the model's mean in the hue and brightness of what it knows.
TEST(SkinChart, AlbedoGoesOnInItsOwnHue) {
  mesh::TextureCoordinates at(2, 4);
  at.col(0) << 0.25F, 0.5F;             // the first texel
  at.col(1) << 0.25F + 0.5F / 8, 0.5F;  // between it and the next
  at.col(2) << 0.25F + 1.5F / 8, 0.5F;  // beside one that is not known
  at.col(3) << 0.2F, 0.5F;              // beside the chart
  const mesh::Vertices mean = Eigen::Vector3f(0.4F, 0.3F, 0.2F).replicate(1, 4);
  const mesh::Vertices albedo = albedo_at(small_skin(), at, mean);
  ASSERT_EQ(albedo.cols(), 4);
  EXPECT_TRUE(albedo.col(0).isApprox(Eigen::Vector3f(0.5F, 0.4F, 0.3F)));
  EXPECT_TRUE(albedo.col(1).isApprox(Eigen::Vector3f(0.3F, 0.225F, 0.16F)));
  // (0.5 + 0.3) / 2 over 0.4 and so on.
  const Eigen::Vector3f elsewhere(0.4F, 0.3125F, 0.23F);
  EXPECT_TRUE(albedo.col(2).isApprox(elsewhere));
  EXPECT_TRUE(albedo.col(3).isApprox(elsewhere));
  SkinChart without = small_skin();
  without.albedo.clear();
  EXPECT_EQ(albedo_at(without, at, mean).cols(), 0);
}

TEST(FaceModelFile, MissingOrForeignFileIsNamed) {
  const test::TemporaryFolder folder;
  const auto expect_message = [](const std::filesystem::path& file, const char* part) {
    try {
      FaceModel::load(file);
      FAIL() << file << " was read";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      EXPECT_THAT(error.what(), HasSubstr(file.string()));
      EXPECT_THAT(error.what(), HasSubstr(part));
    }
  };
  expect_message(folder.path() / "none.facemodel", "facet model build");
  std::ofstream(folder.path() / "empty.facemodel").flush();
  expect_message(folder.path() / "empty.facemodel", "empty");
  std::ofstream(folder.path() / "text.facemodel") << std::string(1000, 'x');
  expect_message(folder.path() / "text.facemodel", "magic");
  expect_message(folder.path(), "not a regular file");
}

TEST(FaceModelFile, UnwritablePlaceIsAStorageError) {
  const FaceModel model = test::synthetic_model(13);
  try {
    model.save("/nonexistent-folder/m.facemodel");
    FAIL() << "saved";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
  }
}

TEST(FaceModelFile, BrokenModelIsNotSaved) {
  FaceModel model = test::synthetic_model(13);
  model.core_mm[3] = std::nanf("");
  const test::TemporaryFolder folder;
  EXPECT_THROW(model.save(folder.path() / "m.facemodel"), Error);
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "m.facemodel"));
}

TEST(FaceModelFile, EveryTruncationIsRefused) {
  const auto bytes = saved_bytes(test::synthetic_model(13));
  for (std::size_t size = 0; size < bytes.size(); size += 1 + size / 20) {
    EXPECT_NE(refusal({bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size)}), "") << size;
  }
}

TEST(FaceModelFile, EveryDamagedByteIsRefused) {
  const auto bytes = saved_bytes(test::synthetic_model(13));
  for (std::size_t at = 0; at < bytes.size(); at += at < 600 ? 1 : 97) {
    auto damaged = bytes;
    damaged[at] ^= std::byte{0x10};
    EXPECT_NE(refusal(damaged), "") << "byte " << at;
  }
}

TEST(FaceModelFile, NewerVersionIsNamed) {
  auto bytes = saved_bytes(test::synthetic_model(13));
  bytes[8] = std::byte{9};
  EXPECT_THAT(refusal(bytes), HasSubstr("version 9"));
}

TEST(FaceModelFile, TooLargeCoreIsRefusedBeforeMemoryIsTaken) {
  EXPECT_THAT(refusal(saved_bytes(test::synthetic_model(13)), 1000), HasSubstr("allowed: 1000"));
}

TEST(FaceModelFile, GoldenFileOfVersion1StillReads) {
  const FaceModel golden =
      FaceModel::load(std::filesystem::path(FACET_SOURCE_DIR) / "tests/face/golden-v1.facemodel");
  FaceModel expected = test::synthetic_model(5);
  expected.name = "golden version 1";
  expect_same(golden, expected);
}

}  // namespace
}  // namespace facet::face
