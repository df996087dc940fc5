#pragma once

#include <dlfcn.h>

#include <string>

#include "facet/error.hpp"

namespace facet {

/// A library that is opened where it is needed, so that programs start, and do the rest, on machines without
/// it. It stays open: what it has started may run on in it. Any thread.
class SharedLibrary {
 public:
  /// soname   "libavcodec.so.59"
  /// package  the one of Debian that has it, for the message
  /// Throws Error(Unavailable) that names both.
  SharedLibrary(std::string soname, const std::string& package) : soname_(std::move(soname)) {
    handle_ = ::dlopen(soname_.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
    if (handle_ == nullptr) {
      const char* why = ::dlerror();
      throw Error(ErrorKind::Unavailable, soname_ + " can't be opened (" +
                                              (why != nullptr ? why : "no reason") +
                                              "); install it with: apt install " + package);
    }
  }

  /// Throws Error(Unavailable) where the library has no such function.
  template <typename Function>
  void find(Function*& function, const char* name) const {
    function = reinterpret_cast<Function*>(::dlsym(handle_, name));
    if (function == nullptr) {
      throw Error(ErrorKind::Unavailable, soname_ + " has no " + name +
                                              ": it is not the library that this "
                                              "program was built for");
    }
  }

 private:
  std::string soname_;
  void* handle_ = nullptr;
};

}  // namespace facet
