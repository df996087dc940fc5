#include "facet/printable.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>

#include "support/paths.hpp"

namespace facet {
namespace {

TEST(Printable, WhatSteersATerminalIsShown) {
  EXPECT_EQ(printable("\x1b]0;owned\x07"), "\\x1b]0;owned\\x07");
  EXPECT_EQ(printable("two\nlines\r\tand\x7f"), "two\\x0alines\\x0d\\x09and\\x7f");
  EXPECT_EQ(printable(std::string("a\0b", 3)), "a\\x00b");
  EXPECT_EQ(printable("\xc2\x9b"
                      "31m \xc2\x85"),
            "\\u{009b}31m \\u{0085}")
      << "the control characters of eight bits";
  EXPECT_EQ(printable("\xe2\x80\xaetxt.exe\xe2\x81\xa6"), "\\u{202e}txt.exe\\u{2066}");
  EXPECT_EQ(printable("\xe2\x80\xa8\xef\xbb\xbf"), "\\u{2028}\\u{feff}");
}

TEST(Printable, AllElseStays) {
  for (const char* text : {"", "C:\\take \\x1b", "M\xc3\xbcller", "\xe9\xa1\x94", "\xf0\x9f\x98\x80",
                           "\xc2\xa0", "\xf4\x8f\xbf\xbf"}) {
    EXPECT_EQ(printable(text), text);
  }
}

TEST(Printable, WhatIsNoUtf8IsShownByByte) {
  EXPECT_EQ(printable("\xff\xfe"), "\\xff\\xfe");
  EXPECT_EQ(printable("\x9b"), "\\x9b");
  EXPECT_EQ(printable("a\xc3"), "a\\xc3") << "cut off";
  EXPECT_EQ(printable("\xe2\x80z"), "\\xe2\\x80z");
  EXPECT_EQ(printable("\xc0\x9b\xe0\x80\x9b"), "\\xc0\\x9b\\xe0\\x80\\x9b") << "longer than need be";
  EXPECT_EQ(printable("\xed\xa0\x80"), "\\xed\\xa0\\x80") << "half a pair of UTF-16";
  EXPECT_EQ(printable("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80") << "beyond Unicode";
}

TEST(Printable, LengthIsBoundedByWholeLetters) {
  EXPECT_EQ(printable("ab\x1b", 5), "ab");
  EXPECT_EQ(printable("ab\x1b", 6), "ab\\x1b");
  EXPECT_EQ(printable("a\xc3\xbc", 2), "a");
}

TEST(Printable, HoldsNoControlCharacterAndIsTheSameShownAgain) {
  std::mt19937 random(1);
  std::uniform_int_distribution<int> byte(0, 255);
  for (int round = 0; round < 20'000; ++round) {
    std::string text(static_cast<std::size_t>(round % 17), ' ');
    for (char& letter : text) {
      letter = static_cast<char>(byte(random));
    }
    const std::string shown = printable(text, 40);
    EXPECT_LE(shown.size(), 40U);
    EXPECT_EQ(printable(shown), shown);
    for (const char letter : shown) {
      EXPECT_FALSE(static_cast<unsigned char>(letter) < 0x20 || letter == 0x7f);
    }
  }
}

/// What is printed past tell() may steer the terminal.
TEST(Printable, ToolsPrintThroughItAlone) {
  int read = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(std::filesystem::path(FACET_SOURCE_DIR) / "tools")) {
    const std::string extension = entry.path().extension();
    if ((extension != ".cpp" && extension != ".hpp") || entry.path().filename() == "tell.hpp") {
      continue;
    }
    ++read;
    std::ifstream stream(entry.path());
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    for (const char* call : {"fmt::print", "std::cout", "std::cerr", "printf(", "fputs("}) {
      EXPECT_EQ(text.find(call), std::string::npos) << entry.path() << " calls " << call;
    }
  }
  EXPECT_GT(read, 50);
}

}  // namespace
}  // namespace facet
