#include "person/person_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

using ::testing::HasSubstr;

class PersonFileTest : public ::testing::Test {
 protected:
  PersonFileTest() : model_(test::synthetic_model(21)) {
    person_.name = "Ada";
    person_.created_utc = "2026-11-25T15:04:05Z";
    person_.software = "test";
    person_.model_name = model_.name;
    person_.model_checksum = model_checksum(model_);
    person_.keyframes = 14;
    person_.span = {-31, 29, -8, 9};
    person_.focal_px = 1043.5;
    person_.width_px = 1280;
    person_.height_px = 720;
    person_.gates = {{"held-out flow, px", 0.31, 0.74, true, ""}};
    person_.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0.25F);
    person_.neutral_mm = model_.contract_identity(person_.identity).neutral_mm;
    person_.sigma_mm.assign(static_cast<std::size_t>(model_.vertex_count()),
                            std::numeric_limits<float>::quiet_NaN());
    person_.sigma_mm[5] = 0.2F;
    person_.skin.width = 2;
    person_.skin.height = 2;
    person_.skin.texels_per_unit = 700;
    person_.skin.relief_mm = {0, 0.25F, -0.125F, 1};
    person_.skin.albedo.assign(12, 0.25F);
  }

  std::string refusal(const std::string& bytes) const {
    try {
      parse_person(std::as_bytes(std::span(bytes)), "x.person");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return error.what();
    }
    return "";
  }

  std::string written() const {
    std::filesystem::remove(file_);
    write_person(person_, file_);
    std::ifstream in(file_, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }

  face::FaceModel model_;
  PersonFile person_;
  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "ada.person";
};

TEST_F(PersonFileTest, ComesBackAsItWas) {
  write_person(person_, file_);
  const PersonFile read = read_person(file_);
  EXPECT_EQ(read.name, "Ada");
  EXPECT_EQ(read.keyframes, 14);
  EXPECT_EQ(read.skin.width, 2);
  EXPECT_EQ(read.skin.texels_per_unit, 700);
  ASSERT_EQ(read.skin.relief_mm.size(), 4U);
  EXPECT_NEAR(read.skin.relief_mm[2], -0.125F, 1e-6F);
  ASSERT_EQ(read.skin.albedo.size(), 12U);
  EXPECT_NEAR(read.skin.albedo[2], 0.25F, 0.004F);
  const face::FaceModel own = model_of(read, model_, "ada.person");
  EXPECT_EQ(own.skin.relief_mm, read.skin.relief_mm) << "the person's model has the skin";
  EXPECT_EQ(read.span.largest_yaw, 29);
  EXPECT_EQ(read.focal_px, 1043.5);
  EXPECT_EQ(read.identity, person_.identity);
  EXPECT_EQ(read.neutral_mm, person_.neutral_mm);
  EXPECT_EQ(read.sigma_mm[5], 0.2F);
  ASSERT_EQ(read.gates.size(), 1U);
  EXPECT_TRUE(read.gates[0].passed);
  EXPECT_EQ(model_of(read, model_, "ada.person").check(), "");
}

TEST_F(PersonFileTest, IsReadableByItsOwnerAlone) {
  write_person(person_, file_);
  struct stat status {};
  ASSERT_EQ(::stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0600U);
}

TEST_F(PersonFileTest, NobodyIsReplaced) {
  const std::string earlier = written();
  person_.name = "Grace";
  try {
    write_person(person_, file_);
    FAIL() << "replaced";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("ada.person' exists already"));
  }
  EXPECT_EQ(read_person(file_).name, "Ada");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_.path()), {}), 1) << "no part is left";
}

TEST_F(PersonFileTest, WhoIsEnrolledOnceMoreIsReplaced) {
  written();
  const PersonFile before = read_person(file_);
  PersonFile better = before;
  better.keyframes = 28;
  replace_person(better, before, file_);
  EXPECT_EQ(read_person(file_).keyframes, 28);
  struct stat status {};
  ASSERT_EQ(::stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0600U);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_.path()), {}), 1) << "no part is left";
}

/// A solve takes minutes: what somebody else did with the file meanwhile stands.
TEST_F(PersonFileTest, WhoWasDeletedOrChangedMeanwhileStaysSo) {
  written();
  const PersonFile before = read_person(file_);
  PersonFile other = before;
  other.keyframes = 21;
  replace_person(other, before, file_);
  EXPECT_THROW(replace_person(before, before, file_), Error);
  EXPECT_EQ(read_person(file_).keyframes, 21);
  std::filesystem::rename(file_, folder_.path() / "elsewhere.person");
  std::filesystem::create_symlink(folder_.path() / "elsewhere.person", file_);
  EXPECT_THROW(replace_person(before, other, file_), Error) << "a link";
  std::filesystem::remove(file_);
  EXPECT_THROW(replace_person(before, other, file_), Error);
  EXPECT_FALSE(std::filesystem::exists(file_));
}

TEST_F(PersonFileTest, AnUncertaintyThatIsNoneIsRefused) {
  for (const float bad : {std::numeric_limits<float>::infinity(), -0.1F, 1e6F}) {
    person_.sigma_mm[7] = bad;
    EXPECT_THAT(refusal(written()), HasSubstr("a standard deviation is negative or far off")) << bad;
  }
}

TEST_F(PersonFileTest, ACutOrDamagedFileIsRefusedByName) {
  const std::string whole = written();
  EXPECT_THAT(refusal(whole.substr(0, whole.size() / 2)), HasSubstr("x.person: unreadable person: it is"));
  EXPECT_THAT(refusal(""), HasSubstr("ends inside the header"));
  std::string later = whole;
  later[8] = 2;
  EXPECT_THAT(refusal(later),
              HasSubstr("format version 2, this program reads version 1; enrol the person again"));
  std::string damaged = whole;
  damaged[whole.size() - 3] = static_cast<char>(damaged[whole.size() - 3] ^ 1);
  EXPECT_THAT(refusal(damaged), HasSubstr("is damaged (checksum)"));
  EXPECT_THAT(refusal("FACETMDL" + whole.substr(8)), HasSubstr("it is not a Facet person (wrong magic)"));
}

TEST_F(PersonFileTest, AFaceThatIsNoneIsRefused) {
  for (const float bad :
       {std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN(), 1e6F}) {
    person_.neutral_mm(1, 7) = bad;
    EXPECT_THAT(refusal(written()), HasSubstr("its face is no face")) << bad;
  }
}

TEST_F(PersonFileTest, APersonOfAnotherModelIsRefusedWithBothNames) {
  face::FaceModel other = model_;
  other.name = "another";
  other.core_mm[4] += 1;
  write_person(person_, file_);
  try {
    model_of(read_person(file_), other, "ada.person");
    FAIL() << "taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("'another'"));
    EXPECT_THAT(error.what(), HasSubstr("'" + model_.name + "'"));
  }
}

}  // namespace
}  // namespace facet::person
