// [web] of the configuration: who may reach the page.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::service {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string listening(const std::string& address) {
  return "[web]\nlisten = \"" + address + "\"\n";
}

std::string error_of(const std::string& text) {
  try {
    parse_config(text, "/etc/facet/facet.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(WebConfig, OthersReachThePageOnlyWhereThatIsMeant) {
  for (const std::string address :
       {"0.0.0.0:80", "[::]:80", "192.168.0.7:80", "booth.example.org:80", "127.example.org:80"}) {
    EXPECT_THAT(error_of(listening(address)), AllOf(StartsWith("/etc/facet/facet.toml:2: web.listen: "),
                                                    HasSubstr("add public = true if that is meant")))
        << address;
    EXPECT_EQ(parse_config(listening(address) + "public = true\n", "f").web.listen, address);
  }
  for (const std::string address :
       {"127.0.0.1:80", "[::1]:80", "localhost:80", "LOCALHOST:80", "127.9.9.9:80"}) {
    EXPECT_EQ(parse_config(listening(address), "f").web.listen, address);
  }
}

}  // namespace
}  // namespace facet::service
