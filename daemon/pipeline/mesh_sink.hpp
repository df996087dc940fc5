#pragma once

#include <memory>

#include "mesh/mesh_frame.hpp"

namespace facet::pipeline {

/// Where finished frames go: the stream, a take, a test.
class MeshSink {
 public:
  MeshSink() = default;
  MeshSink(const MeshSink&) = delete;
  MeshSink& operator=(const MeshSink&) = delete;
  virtual ~MeshSink() = default;

  /// Called with every frame in order, those without a mesh too, on the one thread that makes them
  /// (`facet-refine`, `facet-perform`, `facet-sets`). Must not throw; may block only where nothing may be
  /// lost (recorded sources). May keep the frame as long as it likes.
  virtual void deliver(std::shared_ptr<const mesh::MeshFrame> frame) = 0;

  /// Called for every frame before any sink is given it, on the same thread: adds what the frame is to have
  /// for all of them. Must not throw or block.
  virtual void complete(mesh::MeshFrame& frame) { static_cast<void>(frame); }

  /// Whether a person's mesh should stay the one that it is: what is learned meanwhile waits. Any thread.
  virtual bool wants_one_mesh() const { return false; }
};

}  // namespace facet::pipeline
