#pragma once

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace facet::test {

/// A GPIO chip of 8 lines, "facet0" to "facet7", of the kernel's module gpio-sim; gone with this object.
class SimulatedChip {
 public:
  /// Why there can be none here, for GTEST_SKIP; empty where there can.
  static std::string missing() {
    if (!std::filesystem::exists(kSimulator)) {
      return "no simulated GPIO chip: the kernel's module gpio-sim is not loaded here";
    }
    return ::geteuid() == 0 ? "" : "a simulated GPIO chip can be made by root only";
  }

  SimulatedChip()
      : device_(std::filesystem::path(kSimulator) / ("facet-test-" + std::to_string(::getpid()))) {
    namespace fs = std::filesystem;
    fs::create_directory(device_);
    fs::create_directory(device_ / "bank0");
    write(device_ / "bank0/num_lines", std::to_string(kLines));
    for (int i = 0; i < kLines; ++i) {
      const fs::path line = device_ / ("bank0/line" + std::to_string(i));
      fs::create_directory(line);
      write(line / "name", "facet" + std::to_string(i));
    }
    write(device_ / "live", "1");
    name_ = read(device_ / "live") == "1" ? read(device_ / "bank0/chip_name") : "";
    lines_ = fs::path("/sys/devices/platform") / read(device_ / "dev_name") / name_;
  }
  ~SimulatedChip() {
    write(device_ / "live", "0");
    std::error_code ignored;
    for (int i = 0; i < kLines; ++i) {
      std::filesystem::remove(device_ / ("bank0/line" + std::to_string(i)), ignored);
    }
    std::filesystem::remove(device_ / "bank0", ignored);
    std::filesystem::remove(device_, ignored);
  }
  SimulatedChip(const SimulatedChip&) = delete;
  SimulatedChip& operator=(const SimulatedChip&) = delete;

  const std::string& name() const { return name_; }  ///< such as gpiochip0; empty: it did not become live
  /// "0" or "1": what is at the line's wire.
  std::string level(int line) const { return read(at(line) / "value"); }
  /// Of an input, what its wire is at: "pull-up" or "pull-down".
  void pull(int line, const std::string& to) const { write(at(line) / "pull", to); }

 private:
  static constexpr const char* kSimulator = "/sys/kernel/config/gpio-sim";
  static constexpr int kLines = 8;

  static void write(const std::filesystem::path& file, const std::string& text) {
    std::ofstream(file) << text << std::flush;
  }
  static std::string read(const std::filesystem::path& file) {
    std::string text;
    std::ifstream in(file);
    std::getline(in, text);
    return text;
  }
  std::filesystem::path at(int line) const { return lines_ / ("sim_gpio" + std::to_string(line)); }

  std::filesystem::path device_;
  std::filesystem::path lines_;
  std::string name_;
};

}  // namespace facet::test
