#include "facet/shared_library.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace facet {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string refusal(const std::string& soname, const char* function) {
  try {
    const SharedLibrary library(soname, "libsomething1");
    double (*found)(double) = nullptr;
    library.find(found, function);
    EXPECT_EQ(found(0), 1) << "the cosine of 0";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    return error.what();
  }
  return "";
}

TEST(SharedLibrary, GivesItsFunctionsOrSaysWhatToInstall) {
  EXPECT_EQ(refusal("libm.so.6", "cos"), "");
  EXPECT_THAT(refusal("libm.so.6", "no_such_function"),
              AllOf(HasSubstr("libm.so.6"), HasSubstr("no_such_function")));
  EXPECT_THAT(refusal("libfacet-none.so.1", "cos"),
              AllOf(HasSubstr("libfacet-none.so.1"), HasSubstr("apt install libsomething1")));
}

}  // namespace
}  // namespace facet
