#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "booth/booth_depth.hpp"
#include "options.hpp"
#include "report/depth_folder.hpp"

namespace facet::tools {

/// The processes that find the depth maps of one take together; here, one that is alone. Made and freed by
/// the main thread; its messages are one thread's at a time.
class Team {
 public:
  Team() = default;
  virtual ~Team() = default;
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  virtual int rank() const { return 0; }
  virtual int size() const { return 1; }
  bool leads() const { return rank() == 0; }
  /// Ends the whole team with a status, at once.
  [[noreturn]] virtual void abort(int status) const;

  /// The leader's numbers become everybody's. All members call it at once.
  virtual void share(std::vector<std::uint64_t>& numbers) const;
  /// Sends bytes to the leader, once what was sent before is there; returns while they are under way.
  virtual void send(std::vector<char> bytes, const stereo::Alive& alive);
  /// Waits for what was sent last to be there.
  virtual void finish_sending(const stereo::Alive& alive);
  /// The next bytes of a member. The leader's alone.
  virtual std::vector<char> receive(int member, const stereo::Alive& alive);
};

/// For a process that is alone. Throws facet::Error{Usage} where mpirun started several: each would do the
/// whole work.
std::unique_ptr<Team> join_nobody();

/// `process`, which `facet-team` has, too.
/// join  called once, by a run that reads a booth's take
Command add_process_command(Command program, std::unique_ptr<Team> (*join)());

/// The runs of a take shared out: run n is found by member n modulo the team's size and sent to the leader,
/// so that the depth maps are those of a single process, number for number. What the folder keeps is read by
/// the leader, not found again.
class SharedDepth final : public booth::DepthSource {
 public:
  /// folder: null where none is kept, and for members other than the leader. All members make theirs at once;
  /// main thread.
  SharedDepth(std::unique_ptr<booth::DepthSource> own, Team& team,
              std::shared_ptr<report::DepthFolder> folder);
  ~SharedDepth() override;

  const stereo::DepthRange& depths() const override { return own_->depths(); }
  std::string device() const override;
  std::string find(std::uint64_t first_slot, std::span<const booth::DepthSlot> slots,
                   std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) override;

 private:
  std::string receive(int member, std::vector<std::vector<capture::DepthMap>>& maps,
                      const stereo::Alive& alive);
  void send(const std::vector<std::vector<capture::DepthMap>>& maps, const std::string& wrong,
            const stereo::Alive& alive);

  std::unique_ptr<booth::DepthSource> own_;
  Team& team_;
  std::shared_ptr<report::DepthFolder> folder_;
  std::set<std::uint64_t> kept_;  ///< by the leader's folder
  int run_ = 0;                   ///< that are not kept, so far
};

}  // namespace facet::tools
