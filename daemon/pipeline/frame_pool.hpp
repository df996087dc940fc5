#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "mesh/mesh_frame.hpp"

namespace facet::pipeline {

/// Recycled MeshFrames: a frame returns when its last reader lets go, and keeps the memory of its vectors.
/// After warm-up handing one out allocates the shared_ptr's control block only. The pool holds as many frames
/// as were ever in use at the same time. Any thread; outlived by frames still in use.
class FramePool {
 public:
  FramePool();

  /// A frame with all fields as in a new one, but with room in its vectors; only control_vertices_mm holds
  /// old values (a matrix can't be emptied without giving up its memory): the taker sets it.
  std::shared_ptr<mesh::MeshFrame> take();

 private:
  struct Shelf {
    std::mutex mutex;
    std::vector<std::unique_ptr<mesh::MeshFrame>> frames;  ///< guarded by mutex
  };
  std::shared_ptr<Shelf> shelf_;
};

/// Empties a frame but for control_vertices_mm, and keeps the memory of its vectors.
void clear(mesh::MeshFrame& frame);

}  // namespace facet::pipeline
