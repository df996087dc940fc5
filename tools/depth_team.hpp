#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "depth_folder.hpp"
#include "pipeline/booth_depth.hpp"

namespace facet::tools {

/// This process among those that `mpirun` started together; a process that it did not start is alone. One at
/// a time, made and freed by the main thread.
class Team {
 public:
  Team();
  ~Team();
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  bool leads() const { return rank_ == 0; }
  /// Ends the whole team with a status, at once.
  [[noreturn]] void abort(int status) const;

 private:
  int rank_ = 0;
  int size_ = 1;
  bool started_ = false;
};

/// The runs of a take shared out: run n is found by member n modulo the team's size and sent to the leader,
/// so that the depth maps are those of a single process, number for number. What the folder keeps is read by
/// the leader, not found again.
class SharedDepth final : public pipeline::DepthSource {
 public:
  /// folder: null where none is kept, and for members other than the leader. All members make theirs at once;
  /// main thread.
  SharedDepth(std::unique_ptr<pipeline::DepthSource> own, const Team& team,
              std::shared_ptr<DepthFolder> folder);
  ~SharedDepth() override;

  const stereo::DepthRange& depths() const override { return own_->depths(); }
  std::string device() const override;
  std::string find(std::uint64_t first_slot, std::span<const pipeline::DepthSlot> slots,
                   std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) override;

 private:
  struct Message;
  std::string receive(int member, std::vector<std::vector<capture::DepthMap>>& maps,
                      const stereo::Alive& alive);
  void send(const std::vector<std::vector<capture::DepthMap>>& maps, const std::string& wrong,
            const stereo::Alive& alive);
  void finish_sending(const stereo::Alive& alive);

  std::unique_ptr<pipeline::DepthSource> own_;
  const Team& team_;
  std::shared_ptr<DepthFolder> folder_;
  std::set<std::uint64_t> kept_;      ///< by the leader's folder
  int run_ = 0;                       ///< that are not kept, so far
  std::unique_ptr<Message> sending_;  ///< null: none under way
};

}  // namespace facet::tools
