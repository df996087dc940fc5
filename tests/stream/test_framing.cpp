#include <gtest/gtest.h>

#include <vector>

#include "stream/framing.hpp"

namespace facet::stream {
namespace {

using Outcome = MessageAssembler::Outcome;

std::vector<std::uint8_t> framed(const std::vector<std::uint8_t>& message) {
  const auto header = make_header(message.size());
  std::vector<std::uint8_t> out(header.begin(), header.end());
  out.insert(out.end(), message.begin(), message.end());
  return out;
}

TEST(Framing, MessagesComeTogetherFromPiecesOfAnySize) {
  const std::vector<std::vector<std::uint8_t>> sent = {
      {1, 2, 3}, {}, {4}, std::vector<std::uint8_t>(1000, 9)};
  std::vector<std::uint8_t> wire;
  for (const auto& message : sent) {
    const auto bytes = framed(message);
    wire.insert(wire.end(), bytes.begin(), bytes.end());
  }
  for (const std::size_t piece : {1U, 2U, 3U, 7U, 8U, 9U, 64U, 5000U}) {
    MessageAssembler assembler(1000);
    std::vector<std::vector<std::uint8_t>> got;
    for (std::size_t at = 0; at < wire.size(); at += piece) {
      std::span<const std::uint8_t> bytes(wire.data() + at, std::min(piece, wire.size() - at));
      while (!bytes.empty()) {
        if (assembler.feed(bytes) == Outcome::Complete) {
          got.emplace_back(assembler.message().begin(), assembler.message().end());
          assembler.next();
        }
      }
    }
    EXPECT_EQ(got, sent) << "pieces of " << piece;
  }
}

TEST(Framing, ForeignBytesAreNoticedAtTheHeader) {
  const std::vector<std::uint8_t> wire = {'G', 'E', 'T', ' ', '/', ' ', 'H', 'T', 'T', 'P'};
  std::span<const std::uint8_t> bytes(wire);
  MessageAssembler assembler(1000);
  EXPECT_EQ(assembler.feed(bytes), Outcome::WrongMagic);
}

TEST(Framing, AnnouncedLengthBeyondTheLimitIsRefused) {
  const auto header = make_header(1001);
  std::span<const std::uint8_t> bytes(header);
  MessageAssembler assembler(1000);
  EXPECT_EQ(assembler.feed(bytes), Outcome::TooLong);
}

}  // namespace
}  // namespace facet::stream
