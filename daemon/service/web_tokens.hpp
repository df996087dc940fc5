#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>

#include "facet/clock.hpp"

namespace facet::service {

/// What is shown to be let in over the web: one token opens commands and looking, another looking alone. Each
/// is a line of a file of mode 0640, made where it is not there; one that holds no token is set aside and
/// made anew. Guesses are few: kGuesses in a row from one address, after them one in kGuessPeriod; who
/// guesses shuts nobody else out, not of the own address either (a proxy's is everybody's) where tokens are
/// long enough. One thread.
class WebTokens {
 public:
  /// What a shown token leads to.
  enum class Opens { Look, Commands, Nothing, NothingNow };  ///< NothingNow: too many wrong ones had come

  /// command_file: empty: there are no tokens, and nobody commands. look: looking needs a token, too, whose
  /// file is look_file(command_file). Throws Error(Storage) where a file can't be read or made.
  WebTokens(const std::filesystem::path& command_file, bool look);

  static std::filesystem::path look_file(const std::filesystem::path& command_file);

  bool needed_to_look() const { return needed_to_look_; }
  /// from: the address that it comes from.
  Opens opened_by(std::string_view shown, const std::string& from, Clock::time_point now = Clock::now());
  /// Empty where looking needs none.
  const std::string& look() const { return look_; }
  /// What was wrong with a file that was made anew; empty: nothing.
  const std::string& fault() const { return fault_; }

  static constexpr int kGuesses = 5;
  static constexpr std::chrono::seconds kGuessPeriod{10};
  /// A token of so many letters, as they are made, is found by no guessing: the right one always leads in.
  static constexpr std::size_t kUnguessableBytes = 32;
  static constexpr std::size_t kMostGuessers = 1024;  ///< remembered; then who has guessed least is forgotten

 private:
  struct Guesser {
    int left = kGuesses;
    Clock::time_point last;
  };
  Opens of_length(std::string_view shown, std::size_t least_bytes) const;
  void forget_guessers(Clock::time_point now);
  std::string read(const std::filesystem::path& file);

  std::string fault_;
  std::string command_;
  std::string look_;
  bool needed_to_look_;
  std::map<std::string, Guesser> guessers_;
};

}  // namespace facet::service
