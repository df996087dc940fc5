#include "mpi_team.hpp"

#include <mpi.h>

#include <chrono>
#include <cstdlib>
#include <limits>
#include <thread>
#include <utility>

#include "facet/error.hpp"

namespace facet::tools {
namespace {

/// MPI's own waiting keeps a core busy; a depth map takes much longer than this.
constexpr std::chrono::milliseconds kPollPeriod{3};
constexpr int kTag = 1;

/// Set by Open MPI's mpirun and by those that follow PMIx and PMI.
bool started_together() {
  return std::getenv("OMPI_COMM_WORLD_SIZE") != nullptr || std::getenv("PMIX_RANK") != nullptr ||
         std::getenv("PMI_RANK") != nullptr;
}

class MpiTeam final : public Team {
 public:
  MpiTeam() {
    int provided = 0;
    ::MPI_Init_thread(nullptr, nullptr, MPI_THREAD_SERIALIZED, &provided);
    ::MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    ::MPI_Comm_size(MPI_COMM_WORLD, &size_);
    if (provided < MPI_THREAD_SERIALIZED) {
      ::MPI_Finalize();
      throw Error(ErrorKind::Internal, "this MPI has no messages from threads (MPI_THREAD_SERIALIZED)");
    }
  }
  ~MpiTeam() override { ::MPI_Finalize(); }

  int rank() const override { return rank_; }
  int size() const override { return size_; }

  [[noreturn]] void abort(int status) const override {
    ::MPI_Abort(MPI_COMM_WORLD, status);
    std::_Exit(status);
  }

  void share(std::vector<std::uint64_t>& numbers) const override {
    auto count = static_cast<std::uint64_t>(numbers.size());
    ::MPI_Bcast(&count, 1, MPI_UINT64_T, 0, MPI_COMM_WORLD);
    numbers.resize(count);
    ::MPI_Bcast(numbers.data(), static_cast<int>(count), MPI_UINT64_T, 0, MPI_COMM_WORLD);
  }

  void send(std::vector<char> bytes, const stereo::Alive& alive) override {
    finish_sending(alive);
    if (bytes.size() > std::numeric_limits<int>::max()) {
      throw Error(ErrorKind::Usage, "the depth maps are too large for several processes: run one alone");
    }
    sending_ = std::move(bytes);
    ::MPI_Isend(sending_.data(), static_cast<int>(sending_.size()), MPI_CHAR, 0, kTag, MPI_COMM_WORLD,
                &request_);
  }

  void finish_sending(const stereo::Alive& alive) override {
    for (int done = 0; request_ != MPI_REQUEST_NULL && done == 0;) {
      ::MPI_Test(&request_, &done, MPI_STATUS_IGNORE);
      if (done == 0) {
        alive();
        std::this_thread::sleep_for(kPollPeriod);
      }
    }
    sending_ = {};
  }

  std::vector<char> receive(int member, const stereo::Alive& alive) override {
    MPI_Status status;
    for (int there = 0; there == 0;) {
      ::MPI_Iprobe(member, kTag, MPI_COMM_WORLD, &there, &status);
      if (there == 0) {
        alive();
        std::this_thread::sleep_for(kPollPeriod);
      }
    }
    int length = 0;
    ::MPI_Get_count(&status, MPI_CHAR, &length);
    std::vector<char> bytes(static_cast<std::size_t>(length));
    ::MPI_Recv(bytes.data(), length, MPI_CHAR, member, kTag, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
    return bytes;
  }

 private:
  int rank_ = 0;
  int size_ = 1;
  std::vector<char> sending_;
  MPI_Request request_ = MPI_REQUEST_NULL;  ///< of sending_
};

}  // namespace

std::unique_ptr<Team> join_mpi_team() {
  if (!started_together()) {
    throw Error(ErrorKind::Usage,
                "it is started by mpirun: mpirun -n 4 facet-team process --rig RIG ... (one process alone is "
                "`facet process`)");
  }
  return std::make_unique<MpiTeam>();
}

}  // namespace facet::tools
