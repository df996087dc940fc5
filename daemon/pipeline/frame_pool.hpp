#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "facet/frame_set.hpp"
#include "facet/mutex.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::pipeline {

/// Empties a frame but for control_vertices_mm, and keeps the memory of its vectors.
void clear(mesh::MeshFrame& frame);
/// Lets go of the pictures.
void clear(FrameSet& set);

/// Recycled objects: one returns when its last reader lets go, is emptied by clear, and keeps the memory of
/// its vectors. After warm-up handing one out allocates the shared_ptr's control block only. The pool holds
/// as many objects as were ever in use at the same time. Any thread; outlived by objects still in use.
template <typename T>
class Pool {
 public:
  Pool() : shelf_(std::make_shared<Shelf>()) {}

  /// An object with all fields as in a new one, but with room in its vectors. Only what clear leaves holds
  /// old values, such as control_vertices_mm (a matrix can't be emptied without giving up its memory): the
  /// taker sets it.
  std::shared_ptr<T> take() {
    std::unique_ptr<T> item;
    {
      const Lock lock(shelf_->mutex);
      if (!shelf_->items.empty()) {
        item = std::move(shelf_->items.back());
        shelf_->items.pop_back();
      }
    }
    if (item == nullptr) {
      item = std::make_unique<T>();
    }
    return {item.release(), [shelf = shelf_](T* used) {
              std::unique_ptr<T> back(used);
              clear(*back);
              const Lock lock(shelf->mutex);
              shelf->items.push_back(std::move(back));
            }};
  }

 private:
  struct Shelf {
    Mutex mutex;
    std::vector<std::unique_ptr<T>> items FACET_GUARDED_BY(mutex);
  };
  std::shared_ptr<Shelf> shelf_;
};

using FramePool = Pool<mesh::MeshFrame>;

}  // namespace facet::pipeline
