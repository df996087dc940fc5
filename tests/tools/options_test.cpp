// The door to CLI11: what a command line may say, and how the program says no.

#include "options.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "facet/error.hpp"

using testing::HasSubstr;

namespace facet::tools {
namespace {

struct Values {
  std::string folder = "here";
  std::string output;
  std::uint64_t count = 3;
  double speed = 1;
  std::vector<std::string> names;
  bool quiet = false;
  int runs = 0;
};

struct Outcome {
  int status;
  std::string text;  ///< standard output and error
  Values values;
};

Outcome run(std::vector<std::string> arguments, ErrorKind failure = ErrorKind::Usage, bool fails = false) {
  Outcome outcome{};
  Values& values = outcome.values;
  arguments.insert(arguments.begin(), "sample");
  std::vector<char*> argv;
  for (std::string& argument : arguments) {
    argv.push_back(argument.data());
  }
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  outcome.status = run_program(
      {"sample", "A sample.", "The end."},
      [&](Command program) {
        const Command work = program.subcommand("work", "Works");
        work.option("folder", values.folder, "Where").shows_default();
        work.option("-o,--output", values.output, "PNG to write").ends_in({".png", ".pdf", ".ply"});
        work.option("--count", values.count, "How many").shows_default().range(1, 9);
        work.option("--speed", values.speed, "How fast").range(0.5, 2.0).excludes("--count");
        work.option("--name", values.names, "Of each").one_at_a_time().one_of({"a", "b"});
        work.flag("--quiet", values.quiet, "Says nothing").needs("--output");
        work.footer("Works well.");
        work.callback([&values, failure, fails] {
          ++values.runs;
          if (fails) {
            throw Error(failure, "did not\x1b work");
          }
        });
        program.subcommand("group", "Has more").requires_subcommand();
      },
      static_cast<int>(argv.size()), argv.data());
  outcome.text = testing::internal::GetCapturedStdout() + testing::internal::GetCapturedStderr();
  return outcome;
}

TEST(Options, AreReadAndTheCommandRuns) {
  const Outcome outcome =
      run({"work", "there", "--count", "9", "--name", "a", "--name", "b", "--quiet", "-o", "x.ply"});
  EXPECT_EQ(outcome.status, 0) << outcome.text;
  EXPECT_EQ(outcome.values.runs, 1);
  EXPECT_EQ(outcome.values.folder, "there");
  EXPECT_EQ(outcome.values.count, 9U);
  EXPECT_EQ(outcome.values.names, (std::vector<std::string>{"a", "b"}));
  EXPECT_TRUE(outcome.values.quiet);
}

TEST(Options, HelpSaysDefaultsAndWhatMayBe) {
  const Outcome outcome = run({"work", "--help"});
  EXPECT_EQ(outcome.status, 0);
  EXPECT_EQ(outcome.values.runs, 0);
  for (const char* part :
       {"folder TEXT=here", "--count UINT:INT in [1 - 9]=3", "--speed FLOAT:FLOAT in [0.5 - 2]",
        "--name TEXT:{a,b} ...", "Excludes: --count", "Needs: --output", "Works well."}) {
    EXPECT_THAT(outcome.text, HasSubstr(part));
  }
}

TEST(Options, WhatMayNotBeIsUsage) {
  const auto refused = [](const std::vector<std::string>& arguments, const std::string& why) {
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.status, static_cast<int>(ErrorKind::Usage));
    EXPECT_THAT(outcome.text, HasSubstr(why));
    EXPECT_EQ(outcome.values.runs, 0);
  };
  refused({}, "A subcommand is required");
  refused({"group"}, "A subcommand is required");
  refused({"wrok"}, "sample: there is no command or option 'wrok' (sample --help lists them)");
  refused({"group", "wrok"}, "there is no command or option 'wrok'");
  refused({"--cuont", "2"}, "there is no command or option '--cuont'");
  refused({"work", "--count", "10"}, "--count: Value 10 not in range 1 to 9");
  refused({"work", "--count", "few"}, "few");
  refused({"work", "--speed", "0.4"}, "--speed: Value 0.4 not in range 0.5");
  refused({"work", "--speed", "1", "--count", "2"}, "--count excludes --speed");
  refused({"work", "--quiet"}, "--quiet requires --output");
  refused({"work", "--name", "c"}, "--name: c not in {a,b}");
  refused({"work", "here", "--name", "a", "b"}, "not expected: b");
  refused({"work", "-o", "x.txt"}, "--output: 'x.txt' must end in .png, .pdf or .ply");
}

TEST(Options, AFailureIsToldWithItsKind) {
  const Outcome outcome = run({"work"}, ErrorKind::Storage, true);
  EXPECT_EQ(outcome.status, static_cast<int>(ErrorKind::Storage));
  EXPECT_THAT(outcome.text, HasSubstr("sample: did not"));
  EXPECT_EQ(outcome.text.find('\x1b'), std::string::npos);
}

TEST(Options, AWholeNumberIsReadWhole) {
  EXPECT_EQ(read_int("12"), 12);
  EXPECT_EQ(read_int("12 "), std::nullopt);
  EXPECT_EQ(read_int("99999999999"), std::nullopt);
  EXPECT_EQ(read_int(""), std::nullopt);
}

}  // namespace
}  // namespace facet::tools
