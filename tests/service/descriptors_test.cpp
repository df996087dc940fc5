#include "service/descriptors.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <vector>

#include "daemon_fixture.hpp"
#include "service/config.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {
namespace {

Config with_page() {
  Config config = default_config();
  config.web.listen = "127.0.0.1:8420";
  config.stream.max_web_readers = config.web.max_readers;
  return config;
}

TEST(Descriptors, ThoseOfTheUsualLimitAreEnoughForTheDefaults) {
  Config config = with_page();
  EXPECT_LE(descriptors_needed(config), 1024U);
  EXPECT_EQ(fit_descriptors(config, 1024), "");
  EXPECT_EQ(config.stream.max_readers, 64);
}

TEST(Descriptors, PlacesAreLoweredUntilTheyFit) {
  Config config = with_page();
  config.stream.max_readers = 1000;
  EXPECT_THAT(fit_descriptors(config, 1024), HasSubstr("too few"));
  EXPECT_LE(descriptors_needed(config), 1024U);
  EXPECT_LT(config.stream.max_readers, 1000);
  EXPECT_EQ(config.control.max_clients, 64U) << "what has many places is lowered first";

  Config hopeless = with_page();
  EXPECT_THAT(fit_descriptors(hopeless, 64), HasSubstr("may find none left"));
  EXPECT_EQ(hopeless.stream.max_readers, 2);
}

/// Where nobody gets in any more, a recording still begins, opens its files and ends.
TEST_F(Daemon, RecordsWhileStrangersHoldAllTheirDescriptors) {
  const auto config = folder_.path() / "facet.toml";
  std::ofstream(config) << "mode = \"frames\"\n[[camera]]\nname = \"left\"\nkind = \"simulated\"\nwidth_px = "
                           "320\nheight_px = 240\nrate_hz = 30.0\n[trigger]\nkind = \"virtual\"\n"
                           "slots_per_second = 30.0\nexposure_us = 5000\npatterns = [[]]\nreal_time = false\n"
                           "[[trigger.line]]\nname = \"cameras\"\nrole = \"camera\"\n"
                           "[stream]\nsocket = \"stream.sock\"\nmax_readers = 1000\n[control]\nsocket = "
                           "\"control.sock\"\n[takes]\nfolder = \"takes\"\ndisk_reserve_mb = 1\n[metrics]\n"
                           "listen = \"\"\n";
  Birth birth;
  birth.most_descriptors = 256;
  const auto daemon = start(config.string(), birth);
  await(*daemon, [](const json& now) { return now["state"] == "running"; });
  EXPECT_THAT(daemon->output(), HasSubstr("256 file descriptors are too few"));
  std::vector<stream::FileDescriptor> crowd;
  for (int i = 0; i < 300; ++i) {
    crowd.push_back(stream::connect_unix(folder_.path() / "stream.sock"));
  }
  EXPECT_NO_THROW(ask("record.start", {{"name", "r"}}));
  await(*daemon, [](const json& now) { return now["recording"]["frames"] >= 5; });
  const json taken = ask("record.stop");
  EXPECT_EQ(taken["state"], "finished") << taken;
  EXPECT_GE(taken["frames"], 5);
  crowd.clear();
  ask("shutdown");
  expect_clean_end(*daemon);
}

}  // namespace
}  // namespace facet::service
