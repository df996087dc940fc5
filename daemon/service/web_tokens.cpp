#include "service/web_tokens.hpp"

#include <fmt/format.h>
#include <sys/random.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <system_error>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::service {
namespace {

constexpr std::size_t kLeastTokenBytes = 16;
constexpr std::size_t kMostTokenBytes = 128;

std::string make_token(const std::filesystem::path& file) {
  std::array<std::uint8_t, 16> random{};
  if (::getrandom(random.data(), random.size(), 0) != static_cast<ssize_t>(random.size())) {
    throw Error(ErrorKind::Internal, fmt::format("no random numbers for a token: {}", std::strerror(errno)));
  }
  std::string token;
  for (const std::uint8_t byte : random) {
    token += fmt::format("{:02x}", byte);
  }
  try {
    files::OutputFile out(file, 0640);
    out.write(token + "\n");
    out.commit();
  } catch (const Error& error) {
    throw Error(ErrorKind::Storage,
                fmt::format("web.token_file: {}; web.token_file = \"\" does without", error.what()));
  }
  return token;
}

/// Takes as long wherever the two differ.
bool same_token(std::string_view shown, std::string_view token) {
  if (token.empty() || shown.size() != token.size()) {
    return false;
  }
  unsigned difference = 0;
  for (std::size_t i = 0; i < token.size(); ++i) {
    difference |= static_cast<unsigned char>(shown[i]) ^ static_cast<unsigned char>(token[i]);
  }
  return difference == 0;
}

}  // namespace

WebTokens::WebTokens(const std::filesystem::path& command_file, bool look)
    : command_(command_file.empty() ? "" : read(command_file)),
      look_(look ? read(look_file(command_file)) : ""),
      needed_to_look_(look) {}

std::filesystem::path WebTokens::look_file(const std::filesystem::path& command_file) {
  std::filesystem::path file = command_file;
  file += ".look";
  return file;
}

std::string WebTokens::read(const std::filesystem::path& file) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    return make_token(file);
  }
  std::string token;
  try {
    token = files::read_text(file, kMostTokenBytes + 2, "token");
  } catch (const Error& error) {
    throw Error(ErrorKind::Storage, fmt::format("web.token_file: {}", error.what()));
  }
  while (!token.empty() && (token.back() == '\n' || token.back() == '\r')) {
    token.pop_back();
  }
  const bool sound = std::all_of(token.begin(), token.end(), [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '-' || c == '_';
  });
  if (!sound || token.size() < kLeastTokenBytes || token.size() > kMostTokenBytes) {
    fault_ += (fault_.empty() ? "" : "; ") + fmt::format(
                                                 "web.token_file = \"{}\": a token is one line of {} to {} "
                                                 "letters, digits, - and _; {}, and a new "
                                                 "one "
                                                 "is made",
                                                 file.string(), kLeastTokenBytes, kMostTokenBytes,
                                                 files::set_aside(file));
    return make_token(file);
  }
  return token;
}

/// Those who have all their guesses again; where that is not enough, the one who has most left.
void WebTokens::forget_guessers(Clock::time_point now) {
  std::erase_if(guessers_, [&](const auto& one) {
    return one.second.left + (now - one.second.last) / kGuessPeriod >= kGuesses;
  });
  if (guessers_.size() >= kMostGuessers) {
    guessers_.erase(std::max_element(guessers_.begin(), guessers_.end(), [](const auto& a, const auto& b) {
      return a.second.left < b.second.left;
    }));
  }
}

/// least_bytes: shorter tokens lead nowhere.
WebTokens::Opens WebTokens::of_length(std::string_view shown, std::size_t least_bytes) const {
  if (command_.size() >= least_bytes && same_token(shown, command_)) {
    return Opens::Commands;
  }
  return look_.size() >= least_bytes && same_token(shown, look_) ? Opens::Look : Opens::Nothing;
}

WebTokens::Opens WebTokens::opened_by(std::string_view shown, const std::string& from,
                                      Clock::time_point now) {
  if (const Opens opens = of_length(shown, kUnguessableBytes); opens != Opens::Nothing) {
    return opens;
  }
  const auto known = guessers_.find(from);
  if (known != guessers_.end()) {
    Guesser& guesser = known->second;
    const auto regained = (now - guesser.last) / kGuessPeriod;
    if (regained > 0) {
      guesser.left = static_cast<int>(std::min<std::int64_t>(kGuesses, guesser.left + regained));
      guesser.last = now;
    }
    if (guesser.left <= 0) {
      return Opens::NothingNow;
    }
  }
  if (const Opens opens = of_length(shown, 0); opens != Opens::Nothing) {
    return opens;
  }
  if (known == guessers_.end()) {
    forget_guessers(now);
  }
  Guesser& guesser = guessers_[from];
  if (guesser.left == kGuesses) {
    guesser.last = now;
  }
  --guesser.left;
  return Opens::Nothing;
}

}  // namespace facet::service
