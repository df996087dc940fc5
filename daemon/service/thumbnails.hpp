#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

namespace facet::service {

/// Small pictures of takes, drawn by the processor from the mesh in a take's middle and kept in
/// FOLDER/.thumbnails/NAME.png; made anew where the take is younger. One thread, `facet-pictures`, which
/// start begins and stop joins; it gives way to all others, and draws one take at a time.
class Thumbnails {
 public:
  explicit Thumbnails(std::filesystem::path folder);
  ~Thumbnails();
  Thumbnails(const Thumbnails&) = delete;
  Thumbnails& operator=(const Thumbnails&) = delete;

  void start();
  void request_stop();  ///< first phase; any thread
  bool finished() const;
  void stop();  ///< second phase: the picture in work is finished

  /// A number that changes with the take's picture. Where there is none yet nothing, and it will be drawn, if
  /// the take can be read: ask again later. Any thread.
  std::optional<std::int64_t> ask(const std::string& take);

  /// Where the picture of a take is kept, be it there or not. Throws Error(Usage) where it is no take's name.
  static std::filesystem::path file(const std::filesystem::path& folder, const std::string& take);

  static constexpr int kWidth_px = 150;
  static constexpr int kHeight_px = 180;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
