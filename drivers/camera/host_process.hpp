#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "camera/host_protocol.hpp"

namespace facet::camera {

/// Where the program lies that has a camera in it: $FACET_CAMERA_HOST, else beside the running program, else
/// in
/// ../lib/facet from there, else in the build folder that the running program lies in. Throws
/// DeviceFault(Failing) where it is nowhere.
std::filesystem::path host_program();

/// A process with one camera in it. What it says and does is not trusted: whatever is wrong is a
/// DeviceFault(Failing) that tells how the process ended, and the process is to be given up. It does not
/// outlive its HostProcess, the thread that started it, nor this process. One thread.
class HostProcess {
 public:
  /// Starts the program.
  ///
  /// arguments      for the program
  /// picture_bytes  of the memory for one picture, shared with it; 0: none
  HostProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
              std::size_t picture_bytes);
  /// Ends the process at once. One that hangs in the kernel is left to itself after a second and buried
  /// later.
  ~HostProcess();
  HostProcess(const HostProcess&) = delete;
  HostProcess& operator=(const HostProcess&) = delete;

  /// Asks for the next frame.
  void request_frame();

  /// The next message; nothing where none has come. A process that ended is a fault once its last message is
  /// read.
  std::optional<HostMessage> receive();

  /// Waits for a message or the process's end, until `until_ns` (CLOCK_MONOTONIC) at most.
  void wait(std::int64_t until_ns);

  /// Lets the process end by itself, `patience_ms` at most.
  void end_gently(int patience_ms);

  /// The memory of the picture; the process may write into it at any time.
  const std::uint8_t* picture() const { return picture_; }

 private:
  class Descriptor {
   public:
    explicit Descriptor(int fd = -1) : fd_(fd) {}
    Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
      std::swap(fd_, other.fd_);
      return *this;
    }
    ~Descriptor();
    int get() const { return fd_; }

   private:
    int fd_;
  };

  Descriptor share_picture();
  void spawn(const std::filesystem::path& program, const std::vector<std::string>& arguments, int host_socket,
             int memory);
  bool reap(int patience_ms);
  [[noreturn]] void tell_end();

  Descriptor socket_;
  Descriptor process_;  ///< readable once the process has ended
  pid_t pid_ = -1;
  bool seen_ended_ = false;  ///< messages may be left
  bool ended_ = false;       ///< and buried
  int status_ = 0;           ///< of waitpid, once ended_
  std::size_t picture_bytes_;
  const std::uint8_t* picture_ = nullptr;
};

}  // namespace facet::camera
