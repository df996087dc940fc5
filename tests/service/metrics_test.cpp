#include "service/metrics.hpp"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "daemon_fixture.hpp"
#include "facet/error.hpp"
#include "stream/client.hpp"
#include "stream/ring_layout.h"
#include "support/eventually.hpp"
#include "support/source_folder.hpp"

namespace facet::service {
namespace {

/// The answer to a request; empty where nobody answers.
std::string ask_over_http(int port, const std::string& request) {
  const stream::FileDescriptor fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    return "";
  }
  EXPECT_EQ(::send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL), ssize_t(request.size()));
  std::string answer;
  std::array<char, 4096> piece{};
  for (ssize_t count = 1; (count = ::recv(fd.get(), piece.data(), piece.size(), 0)) > 0;) {
    answer.append(piece.data(), static_cast<std::size_t>(count));
  }
  return answer;
}

/// The body of http://127.0.0.1:port/metrics; empty where nobody answers.
std::string scrape(int port) {
  const std::string answer = ask_over_http(port, "GET /metrics HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n");
  const std::size_t body = answer.find("\r\n\r\n");
  return body == std::string::npos ? "" : answer.substr(body + 4);
}

MetricsConfig anywhere() {
  MetricsConfig config;
  config.listen = "127.0.0.1:0";
  return config;
}

MetricsSnapshot snapshot() {
  MetricsSnapshot now;
  now.state = "running";
  now.web = WebStatistics{100, 3, 1, "a wrong token was shown"};
  now.uptime_s = 12.5;
  now.disk_free_bytes = 1000;
  now.pipeline.captured = 100;
  now.pipeline.dropped = 3;
  now.pipeline.tracking = mesh::TrackingState::Tracking;
  now.pipeline.histograms[3].add(1.5F);
  now.pipeline.histograms[3].add(30);
  now.pipeline.histograms[3].add(9000);
  pipeline::DevicesStatus rig;
  pipeline::DeviceCameraStatus camera;
  camera.name = "left";
  camera.status.state = CameraState::Stalled;
  camera.status.counters.lost = 7;
  rig.cameras.push_back(camera);
  rig.trigger.emplace();
  rig.trigger->slots_dropped = 2;
  capture::CameraMatch match;
  match.name = "left";
  match.refused.at(static_cast<std::size_t>(capture::Refusal::TooLate)) = 5;
  rig.sets.cameras.push_back(match);
  rig.sets.incomplete = 9;
  now.pipeline.rig = rig;
  stream::ReaderStatistics reader;
  reader.id = 4;
  reader.client = "a \"game\"";
  reader.frames_dropped = 6;
  now.stream.readers.push_back(reader);
  now.take.emplace();
  now.take->bytes = 12345;
  return now;
}

TEST(Metrics, TellWhatTheDaemonDoes) {
  const MetricsServer server(anywhere(), snapshot);
  const std::string text = scrape(server.port());
  for (const char* line :
       {"facet_state{state=\"running\"} 1", "facet_state{state=\"failed\"} 0", "facet_uptime_seconds 12.5",
        "facet_disk_free_bytes 1000", "facet_frames_total{outcome=\"dropped\"} 3",
        "facet_tracking_state{state=\"tracking\"} 1", "facet_stage_seconds_count{stage=\"fit\"} 3",
        "facet_stage_seconds_bucket{stage=\"fit\",le=\"0.002\"} 1",
        "facet_stage_seconds_bucket{stage=\"fit\",le=\"2\"} 2",
        "facet_stage_seconds_bucket{stage=\"fit\",le=\"+Inf\"} 3",
        "facet_camera_state{camera=\"left\",state=\"stalled\"} 1",
        "facet_camera_frames_total{camera=\"left\",outcome=\"lost\"} 7",
        "facet_camera_refused_total{camera=\"left\",cause=\"too_late\"} 5",
        "facet_sets_total{outcome=\"incomplete\"} 9", "facet_trigger_slots_total{outcome=\"dropped\"} 2",
        "facet_stream_reader_dropped_total{reader=\"4\",client=\"a \\\"game\\\"\"} 6", "facet_recording 1",
        "facet_take_bytes 12345"}) {
    EXPECT_THAT(text, HasSubstr(std::string(line) + "\n"));
  }
  EXPECT_THAT(text, HasSubstr("# TYPE facet_frames_total counter\n"));
}

TEST(Metrics, APortInUseIsNamed) {
  const MetricsServer server(anywhere(), snapshot);
  const std::string taken = "127.0.0.1:" + std::to_string(server.port());
  try {
    MetricsConfig same;
    same.listen = taken;
    const MetricsServer second(same, snapshot);
    FAIL() << "two servers on one port";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), AllOf(HasSubstr(taken), HasSubstr("in use")));
  }
}

/// A page of a stranger, whose name points at this machine, reads nothing.
TEST(Metrics, AnswerToNamesOfThisMachineAlone) {
  const MetricsServer server(anywhere(), snapshot, {"booth.example.org"});
  const auto ask = [&](const std::string& host) {
    return ask_over_http(server.port(), "GET /metrics HTTP/1.0\r\n" + host + "\r\n");
  };
  for (const char* host : {"localhost", "127.0.0.1:9464", "[::1]", "booth.example.org:9464"}) {
    EXPECT_THAT(ask(std::string("Host: ") + host + "\r\n"), HasSubstr("facet_info")) << host;
  }
  for (const char* host : {"Host: evil.example\r\n", "Host: \r\n", ""}) {
    EXPECT_THAT(ask(host), AllOf(HasSubstr(" 403 "), ::testing::Not(HasSubstr("facet_info")))) << host;
  }
}

/// Connections that ask for nothing do not keep a scrape out.
TEST(Metrics, AreThereWhileHalfRequestsAreOpen) {
  const MetricsServer server(anywhere(), snapshot);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(server.port()));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::vector<stream::FileDescriptor> crowd;
  for (std::size_t i = 0; i < 2 * anywhere().max_connections; ++i) {
    crowd.emplace_back(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(::connect(crowd.back().get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    ASSERT_EQ(::send(crowd.back().get(), "GET /m", 6, MSG_NOSIGNAL), 6);
  }
  EXPECT_THAT(scrape(server.port()), HasSubstr("facet_info"));
}

std::string source_text(const char* name) {
  std::ifstream file(std::filesystem::path(FACET_SOURCE_DIR) / name);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::set<std::string> matches(const std::string& text, const std::regex& pattern) {
  std::set<std::string> found;
  for (std::sregex_iterator at(text.begin(), text.end(), pattern), end; at != end; ++at) {
    found.insert((*at)[1]);
  }
  return found;
}

/// Every row is served, and documented with its labels; the page and the dashboard name no other metric.
TEST(Metrics, DashboardAndDocumentationNameWhatIsThere) {
  std::set<std::string> known;
  const std::string page = source_text("docs/metrics.md");
  for (const Metric& metric : metrics()) {
    const std::string name = std::string("facet_") + metric.name;
    EXPECT_TRUE(known.insert(name).second) << name << " has two rows";
    const std::size_t line = page.find("`" + name + "`");
    ASSERT_NE(line, std::string::npos) << name << " is not documented";
    for (const char* label : metric.labels) {
      if (label != nullptr) {
        EXPECT_THAT(page.substr(line, page.find('\n', line) - line),
                    HasSubstr("`" + std::string(label) + "`"))
            << name;
      }
    }
  }
  EXPECT_EQ(matches(metrics_text(snapshot()), std::regex("# TYPE (facet_[a-z_]+) ")), known);
  const std::regex name("(facet_[a-z_]+?)(_bucket|_count|_sum)?(?![a-z_])");
  EXPECT_EQ(matches(page, name), known);
  const std::string dashboard = source_text("packaging/grafana-dashboard.json");
  ASSERT_TRUE(nlohmann::json::accept(dashboard));
  for (const std::string& shown : matches(dashboard, name)) {
    EXPECT_TRUE(known.contains(shown)) << shown << " is on the dashboard and is not served";
  }
}

TEST(Metrics, AStateIsOneSeriesForEachThatThereIs) {
  MetricsSnapshot now = snapshot();
  now.state = kStatesBeforeThePipeline[1];
  const std::string text = metrics_text(now);
  EXPECT_EQ(matches(text, std::regex("facet_state\\{state=\"([a-z ]+)\"\\}")).size(), 8U);
  EXPECT_THAT(text, HasSubstr("facet_state{state=\"waiting for a reader\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("facet_state{state=\"idle\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("facet_tracking_state{state=\"lost\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("facet_camera_state{camera=\"left\",state=\"ended\"} 0\n"));
}

TEST_F(Daemon, ServesMetrics) {
  const auto config = folder_.path() / "facet.toml";
  std::filesystem::copy_file(std::filesystem::path(FACET_SOURCE_DIR) / "config" / "devices.toml", config);
  std::ofstream(config, std::ios::app)
      << "[stream]\nsocket = \"stream.sock\"\n[control]\nsocket = \"control.sock\"\n[takes]\nfolder = "
         "\"takes\"\n[metrics]\nlisten = \"127.0.0.1:0\"\n";
  const auto daemon = start(config.string());
  await(*daemon, [](const json& now) { return now["state"] == "running"; });
  std::smatch port;
  const std::string log = daemon->output();
  ASSERT_TRUE(std::regex_search(log, port, std::regex("metrics on http://127.0.0.1:([0-9]+)/metrics")))
      << log;
  const int at = std::stoi(port[1]);
  EXPECT_THAT(scrape(at), HasSubstr("\nfacet_stream_ring_readers 0"));
  stream::Subscription subscription;
  subscription.ring_version = FACET_RING_VERSION;
  const stream::StreamClient reader(folder_.path() / "stream.sock", subscription);
  EXPECT_TRUE(test::eventually(
      [&] { return scrape(at).find("\nfacet_stream_ring_readers 1") != std::string::npos; }));
  EXPECT_THAT(scrape(at), HasSubstr("facet_camera_state{camera=\"right\",state="));
  ask("shutdown");
  expect_clean_end(*daemon);
}

}  // namespace
}  // namespace facet::service
