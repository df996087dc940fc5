#include "service/recording.hpp"

#include <fmt/format.h>

#include <utility>

#include "facet/error.hpp"
#include "facet/mutex.hpp"

namespace facet::service {

Recording::Recording(pipeline::TakeSink& sink, SoundDesk& beside, TakeIndex& index, const Log& log)
    : sink_(sink), beside_(beside), index_(index), log_(log) {}

void Recording::begin(take::TakeRecorderConfig config) {
  // One that ended by itself, and was not asked for since, makes room.
  if (const auto before = sink_.status(); before && before->state != take::RecorderState::Recording) {
    close();
  }
  if (const auto running = sink_.status()) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is being recorded: stop it first", running->file.string()));
  }
  beside_.begin(config);
  try {
    sink_.begin(config);
  } catch (...) {
    beside_.cancel();
    throw;
  }
  std::optional<std::string> over;
  {
    const Lock lock(mutex_);
    last_.reset();
    over = end_reason_;
  }
  if (over) {
    beside_.request_end();
    sink_.request_end(*over);
  }
  index_.changed();
  log_.info(fmt::format("recording {}", config.file.string()),
            {{"FACET_EVENT", "take-begun"}, {"FACET_TAKE", config.file.string()}});
}

take::RecorderStatus Recording::stop() {
  const auto take = end_take("");
  index_.changed();
  if (!take) {
    const Lock lock(mutex_);
    throw Error(ErrorKind::Usage, last_ ? fmt::format("nothing is being recorded: {} ended by itself: {}",
                                                      last_->file.string(), last_->reason)
                                        : "nothing is being recorded");
  }
  log(*take);
  return *take;
}

void Recording::end(const std::string& reason) {
  {
    const Lock lock(mutex_);
    end_reason_ = reason;
  }
  beside_.request_end();
  sink_.request_end(reason);
}

/// What stands beside the frames ends no earlier than they do, and is written down with them.
std::optional<take::RecorderStatus> Recording::end_take(std::string reason) {
  if (sink_.status()) {
    beside_.request_end();
  }
  auto ended = sink_.end(std::move(reason));
  beside_.end();
  return ended;
}

void Recording::look_after() {
  const auto take = sink_.status();
  if (!take || take->state != take::RecorderState::Failed || closing_.exchange(true)) {
    return;
  }
  errands_.ask([this] {
    // What was asked meanwhile may have ended it, and begun another one.
    const auto now = sink_.status();
    if (now && now->state == take::RecorderState::Failed) {
      close();
    }
    closing_ = false;
  });
}

/// Of a take that ended by itself: it is told of until the next begins.
void Recording::close() {
  const auto ended = end_take("");
  {
    const Lock lock(mutex_);
    last_ = ended;
  }
  index_.changed();
  if (ended) {
    log(*ended);
  }
}

std::optional<take::RecorderStatus> Recording::status() const {
  if (auto take = sink_.status()) {
    return take;
  }
  const Lock lock(mutex_);
  return last_;
}

void Recording::request_stop(const std::string& reason) {
  errands_.request_stop();
  end(reason);
}

bool Recording::finished() const {
  return errands_.finished() && sink_.ended() && beside_.finished();
}

void Recording::finish() {
  errands_.stop();
  std::string reason;
  {
    const Lock lock(mutex_);
    reason = end_reason_.value_or("");
  }
  if (const auto take = end_take(std::move(reason))) {
    log(*take);
  }
}

void Recording::log(const take::RecorderStatus& take) const {
  const std::string text = fmt::format("take {}: {} frames, {} not recorded, {:.1f} MB", take.file.string(),
                                       take.frames, take.dropped, static_cast<double>(take.bytes) / 1e6);
  if (take.state == take::RecorderState::Failed) {
    log_.error(fmt::format("{}; recording ended by itself: {}", text, take.reason),
               {{"FACET_EVENT", "take-failed"}, {"FACET_TAKE", take.file.string()}});
  } else if (!take.warning.empty()) {
    log_.error(fmt::format("{}; {}", text, take.warning),
               {{"FACET_EVENT", "take-doubtful"}, {"FACET_TAKE", take.file.string()}});
  } else {
    const char* left =
        take.log_left ? "; a part stays in the -wal file beside it, as another program reads it" : "";
    const std::string why = take.reason.empty() ? "" : "; ended: " + take.reason;
    log_.info(text + why + left, {{"FACET_EVENT", "take-ended"}, {"FACET_TAKE", take.file.string()}});
  }
}

}  // namespace facet::service
