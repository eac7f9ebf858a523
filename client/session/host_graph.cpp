// SPDX-License-Identifier: Apache-2.0

#include <client/session/host_graph.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/session/context.hpp>

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <new>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;

Result<std::shared_ptr<const GraphTable>> GraphTable::map(int fd, std::uint64_t number) {
  struct stat file {};
  if (::fstat(fd, &file) != 0) return fail(Errc::os_failure, "looking at the graph table", errno);
  if (file.st_size < static_cast<off_t>(abi::page_bytes))
    return fail(Errc::protocol_violation, "the graph table of agnocastd");
  // The file grows; nothing is touched behind its end.
  auto mapping = Mapping::map(fd, abi::graph_bytes_max, Mapping::Access::read);
  if (!mapping) return tl::unexpected<Failure>(mapping.error());
  std::shared_ptr<const GraphTable> table(new GraphTable(std::move(*mapping), number));
  if (table->header().magic.load(std::memory_order_relaxed) != abi::graph_magic)
    return fail(Errc::protocol_violation, "the graph table of agnocastd");
  return table;
}

std::shared_ptr<const GraphTable> HostGraph::table() const {
  const std::lock_guard lock(mutex_);
  return table_;
}

HostGraph::Failures HostGraph::failures() const noexcept {
  const std::lock_guard lock(mutex_);
  return failures_;
}

void HostGraph::add(int eventfd) {
  const std::lock_guard lock(mutex_);
  waiting_.push_back(eventfd);
}

void HostGraph::remove(int eventfd) noexcept {
  const std::lock_guard lock(mutex_);
  std::erase(waiting_, eventfd);
}

void HostGraph::wake_all() const noexcept {
  const std::uint64_t one = 1;
  for (const int eventfd : waiting_) {
    if (may_use(eventfd)) (void)!::write(eventfd, &one, sizeof one);
  }
}

Result<void> HostGraph::ask(std::uint64_t seen) {
  wire::WatchGraph request{};
  request.seen = seen;
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(is_asked_, true)) return {};
    request.table = table_ != nullptr ? table_->number() : 0;
  }
  const auto give_up = [this] {
    const std::lock_guard lock(mutex_);
    is_asked_ = false;
    wake_all();  // another thread relies on this request
  };
  try {
    Result<void> asked =
        Context::watch_graph(request, [this](Result<Incoming*> answer) { on_answer(answer); });
    if (!asked) give_up();
    return asked;
  } catch (const std::bad_alloc&) {
    give_up();
    throw;
  }
}

void HostGraph::connection_ended() noexcept {
  const std::lock_guard lock(mutex_);
  if (!is_asked_) table_.reset();
}

// In the control thread; in the asking one if the session is orphaned.
void HostGraph::on_answer(Result<Incoming*> answer) noexcept {
  Result<void> taken;
  try {
    taken = answer ? take(**answer) : Result<void>(tl::unexpected<Failure>(answer.error()));
  } catch (const std::bad_alloc&) {
    taken = fail(Errc::os_failure, "mapping the graph table", ENOMEM);
  }
  const std::lock_guard lock(mutex_);
  is_asked_ = false;
  if (!taken) {
    table_.reset();
    ++failures_.count;
    failures_.code = taken.error().code;
    const char* const detail = detail_of(taken.error());
    std::snprintf(failures_.detail, sizeof failures_.detail, "%s",
                  *detail != '\0' ? detail : taken.error().what);
  }
  wake_all();
}

Result<void> HostGraph::take(Incoming& packet) {
  wire::GraphChanged changed{};
  if (packet.header().opcode != wire::Opcode::graph_changed || !packet.read(changed))
    return fail(Errc::protocol_violation, "an answer from agnocastd");
  const auto present = table();
  if (present != nullptr && present->number() == changed.table) return {};
  if (Result<void> read =
          packet.read_as(wire::Opcode::graph_changed, changed, 1, "the graph table of agnocastd");
      !read)
    return read;
  auto mapped = GraphTable::map(packet.packet.fds()[0].get(), changed.table);
  if (!mapped) return tl::unexpected<Failure>(mapped.error());
  const std::lock_guard lock(mutex_);
  table_ = std::move(*mapped);
  return {};
}

}  // namespace agnocast
