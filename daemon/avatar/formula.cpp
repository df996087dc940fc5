#include "avatar/formula.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <limits>
#include <string>
#include <system_error>

#include "facet/error.hpp"

namespace facet::avatar {

/// Recursive descent: sum = product {(+|-) product}; product = factor {(*|/) factor};
/// factor = [-|+] factor | number | name | function "(" sum {"," sum} ")" | "(" sum ")".
class FormulaReader {
 public:
  using Kind = Formula::Kind;

  FormulaReader(std::string_view text, std::vector<Formula::Step>& steps) : text_(text), steps_(steps) {}

  void read() {
    if (text_.size() > Formula::kMostLetters) {
      fail(fmt::format("it is longer than {} letters", Formula::kMostLetters));
    }
    sum();
    if (next() != '\0') {
      fail(fmt::format("'{}' is not expected", text_[at_]));
    }
  }

 private:
  /// Counts how deep the text is nested, for as long as it lives.
  class Nesting {
   public:
    explicit Nesting(FormulaReader& reader) : reader_(reader) {
      if (++reader_.depth_ > Formula::kMostNesting) {
        reader_.fail(fmt::format("it is nested more than {} deep", Formula::kMostNesting));
      }
    }
    ~Nesting() { --reader_.depth_; }
    Nesting(const Nesting&) = delete;
    Nesting& operator=(const Nesting&) = delete;

   private:
    FormulaReader& reader_;
  };

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::Usage, fmt::format("{} (letter {})", what, at_ + 1));
  }

  /// The next letter that is no space; 0 at the end.
  char next() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t' || text_[at_] == '\n')) {
      ++at_;
    }
    if (at_ == text_.size()) {
      return '\0';
    }
    if (text_[at_] == '\0') {
      fail("it has a letter that can't be shown");
    }
    return text_[at_];
  }
  bool take(char wanted) {
    if (next() != wanted) {
      return false;
    }
    ++at_;
    return true;
  }
  void need(char wanted) {
    if (!take(wanted)) {
      fail(fmt::format("'{}' is expected", wanted));
    }
  }

  void push(Formula::Step step) {
    if (++kept_ > Formula::kMostKept) {
      fail(fmt::format("it keeps more than {} numbers at a time", Formula::kMostKept));
    }
    steps_.push_back(step);
  }
  /// A step that makes one number of two.
  void join(Kind kind) {
    --kept_;
    steps_.push_back({kind});
  }

  void sum() {
    const Nesting nesting(*this);
    product();
    for (char c = next(); c == '+' || c == '-'; c = next()) {
      ++at_;
      product();
      join(c == '+' ? Kind::Add : Kind::Subtract);
    }
  }

  void product() {
    factor();
    for (char c = next(); c == '*' || c == '/'; c = next()) {
      ++at_;
      factor();
      join(c == '*' ? Kind::Multiply : Kind::Divide);
    }
  }

  void factor() {
    const Nesting nesting(*this);
    const char c = next();
    if (take('-')) {
      factor();
      steps_.push_back({Kind::Negate});
    } else if (take('+')) {
      factor();
    } else if (take('(')) {
      sum();
      need(')');
    } else if (std::isdigit(static_cast<unsigned char>(c)) != 0 || c == '.') {
      number();
    } else if (std::isalpha(static_cast<unsigned char>(c)) != 0) {
      name();
    } else {
      fail("a number, a value's name or '(' is expected");
    }
  }

  void number() {
    double value = 0;
    const char* begin = text_.data() + at_;
    const auto [end, fault] = std::from_chars(begin, text_.data() + text_.size(), value);
    if (fault != std::errc() || !std::isfinite(value)) {
      fail("this is no number");
    }
    at_ += static_cast<std::size_t>(end - begin);
    push({Kind::Number, value});
  }

  void name() {
    const std::size_t begin = at_;
    while (at_ < text_.size() && std::isalnum(static_cast<unsigned char>(text_[at_])) != 0) {
      ++at_;
    }
    const std::string_view word = text_.substr(begin, at_ - begin);
    if (const int index = mesh::arkit_index(word); index >= 0) {
      push({Kind::Value, 0, static_cast<std::size_t>(index)});
      return;
    }
    if (word == "min" || word == "max") {
      const Kind kind = word == "min" ? Kind::Min : Kind::Max;
      need('(');
      sum();
      need(',');
      do {
        sum();
        join(kind);
      } while (take(','));
      need(')');
    } else if (word == "clamp") {
      need('(');
      sum();
      need(',');
      sum();
      join(Kind::Max);
      need(',');
      sum();
      join(Kind::Min);
      need(')');
    } else if (word == "dead") {
      need('(');
      sum();
      need(',');
      sum();
      join(Kind::Dead);
      need(')');
    } else {
      at_ = begin;
      fail(fmt::format("'{}' is no value of ARKit's, and none of min, max, clamp and dead", word));
    }
  }

  std::string_view text_;
  std::vector<Formula::Step>& steps_;
  std::size_t at_ = 0;
  std::size_t depth_ = 0;
  std::size_t kept_ = 0;
};

namespace {

double divide(double above, double below) {
  return below == 0 ? 0 : above / below;
}

}  // namespace

Formula::Formula(std::string_view text) : text_(text) {
  FormulaReader(text_, steps_).read();
}

float Formula::of(const mesh::ArkitValues& values) const {
  std::array<double, kMostKept> kept{};
  std::size_t count = 0;
  for (const Step& step : steps_) {
    if (step.kind == Kind::Number || step.kind == Kind::Value) {
      kept.at(count++) = step.kind == Kind::Number ? step.number : static_cast<double>(values.at(step.index));
      continue;
    }
    const double last = kept.at(count - 1);
    if (step.kind == Kind::Negate) {
      kept.at(count - 1) = -last;
      continue;
    }
    --count;
    double& first = kept.at(count - 1);
    switch (step.kind) {
      case Kind::Add:
        first += last;
        break;
      case Kind::Subtract:
        first -= last;
        break;
      case Kind::Multiply:
        first *= last;
        break;
      case Kind::Divide:
        first = divide(first, last);
        break;
      case Kind::Min:
        first = std::min(first, last);
        break;
      case Kind::Max:
        first = std::max(first, last);
        break;
      default:  // Dead
        first = first <= last ? 0 : divide(first - last, 1 - last);
    }
  }
  constexpr double kMost = std::numeric_limits<float>::max();
  return std::abs(kept.at(0)) <= kMost ? static_cast<float>(kept.at(0)) : 0;  // 0 for what is no number too
}

}  // namespace facet::avatar
