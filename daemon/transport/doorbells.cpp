// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/doorbells.hpp>

#include <base/sockets/packet_socket.hpp>
#include <daemon/state/steps.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <memory>
#include <set>

namespace agnocast::daemon {
namespace {

// The doorbell owns its descriptors; a packet needs its own.
Result<SharedFd> duplicate(int fd) {
  UniqueFd copy(::fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (!copy) return fail(Errc::os_failure, "duplicating a descriptor", errno);
  return share(std::move(copy));
}

// A descriptor or memory may be available a moment later.
bool is_shortage(int error) noexcept {
  return error == EMFILE || error == ENFILE || error == ENOMEM || error == ENOBUFS;
}

}  // namespace

// If the client never takes it, this copy is the last one, with others' packets in its queue.
Result<SharedFd> Doorbells::duplicate_receiver(int fd, std::uint32_t uid) const {
  if (refuses_descriptors(fd) || !close_) return duplicate(fd);
  UniqueFd copy(::fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (!copy) return fail(Errc::os_failure, "duplicating a descriptor", errno);
  return SharedFd(new UniqueFd(std::move(copy)), [close = close_, uid](const UniqueFd* last) {
    auto* const own = const_cast<UniqueFd*>(last);
    close(uid, std::move(*own));
    delete own;
  });
}

Result<std::vector<SharedFd>> Doorbells::open(ClientIndex client, std::uint64_t wait_set,
                                              std::uint32_t uid) {
  const Key key{number(client), wait_set};
  if (const auto found = doorbells_.find(key); found != doorbells_.end()) {
    if (SharedFd datagram = found->second.given.lock())
      return std::vector<SharedFd>{found->second.eventfd, std::move(datagram)};
    close(client, wait_set);
  }
  auto fds = make(client, wait_set, uid, nullptr);
  if (!fds) return fds;
  if (auto kept = store_.put(DescriptorStore::eventfd(client, wait_set), (*fds)[0]->get()); !kept) {
    doorbells_.erase(key);
    return tl::unexpected(kept.error());
  }
  return fds;
}

Result<std::vector<SharedFd>> Doorbells::make(ClientIndex client, std::uint64_t wait_set,
                                              std::uint32_t uid, SharedFd eventfd) {
  const Key key{number(client), wait_set};
  const std::string name = name_of(key);
  AGNOCAST_CRASH_POINT(B_doorbell_bind);
  ::mkdir(directory_.c_str(), 0700);  // it may have been removed; make_doorbell() checks its owner
  auto receiver = make_doorbell(directory_, name);
  if (!receiver) return tl::unexpected(receiver.error());
  UniqueFd way = way_to(name);
  auto sender = connect_to(way, name);
  if (!sender) return tl::unexpected(sender.error());
  if (eventfd == nullptr) {
    auto own = duplicate(receiver->eventfd());
    if (!own) return tl::unexpected(own.error());
    eventfd = std::move(*own);
  }
  auto datagram = duplicate_receiver(receiver->datagram_fd(), uid);
  if (!datagram) return tl::unexpected(datagram.error());
  doorbells_[key] = Entry{eventfd, *datagram, Doorbell(std::move(*sender)), std::move(way)};
  return std::vector<SharedFd>{std::move(eventfd), std::move(*datagram)};
}

Result<std::vector<SharedFd>> Doorbells::renew(ClientIndex client, std::uint64_t wait_set,
                                               std::uint32_t uid) {
  const Key key{number(client), wait_set};
  const auto found = doorbells_.find(key);
  SharedFd eventfd;
  unsigned left = renewals_max;
  if (found != doorbells_.end()) {
    left = found->second.renewals_left;
    if (left == 0) return std::vector<SharedFd>{};
    const auto sender = connect_to(found->second.way, name_of(key));
    if (sender || sender.error().code != Errc::endpoint_gone) return std::vector<SharedFd>{};
    eventfd = found->second.eventfd;
  }
  const bool is_new = eventfd == nullptr;
  auto fds = make(client, wait_set, uid, std::move(eventfd));
  if (!fds) return fds;
  doorbells_[key].renewals_left = left - 1;
  if (!is_new) return fds;
  if (auto kept = store_.put(DescriptorStore::eventfd(client, wait_set), (*fds)[0]->get()); !kept) {
    doorbells_.erase(key);
    return tl::unexpected(kept.error());
  }
  return fds;
}

void Doorbells::restore(ClientIndex client, std::uint64_t wait_set) {
  const Key key{number(client), wait_set};
  UniqueFd eventfd = store_.take(DescriptorStore::eventfd(client, wait_set));
  if (!eventfd) return;  // its process opens it again
  UniqueFd way = way_to(name_of(key));
  auto sender = connect_to(way, name_of(key));
  const bool is_silent = !sender;
  doorbells_[key] = Entry{share(std::move(eventfd)),
                          {},
                          sender ? Doorbell(std::move(*sender)) : Doorbell(),
                          std::move(way),
                          is_silent,
                          0,
                          is_silent ? renewals_max : 0};
}

std::vector<Doorbells::WaitSetPlace> Doorbells::look() {
  std::vector<WaitSetPlace> silent;
  auto at = doorbells_.upper_bound(looked_at_);
  for (std::size_t looks = std::min(looks_max, doorbells_.size()); looks > 0; --looks, ++at) {
    if (at == doorbells_.end()) at = doorbells_.begin();
    looked_at_ = at->first;
    Entry& doorbell = at->second;
    if (!note(doorbell, connect_to(doorbell.way, name_of(at->first)))) continue;
    if (!doorbell.is_silent) {
      doorbell.silent_looks = 0;
    } else if (doorbell.silent_looks < silent_looks_needed &&
               ++doorbell.silent_looks == silent_looks_needed) {
      silent.push_back({ClientIndex{at->first.first}, at->first.second});
    }
  }
  return silent;
}

bool Doorbells::note(Entry& doorbell, const Result<UniqueFd>& sender) noexcept {
  const bool is_known = sender || !is_shortage(sender.error().os_errno);
  if (is_known) doorbell.is_silent = !sender;
  return is_known;
}

UniqueFd Doorbells::way_to(const std::string& name) const {
  return UniqueFd(::open((directory_ + "/" + name).c_str(), O_PATH | O_CLOEXEC | O_NOFOLLOW));
}

Result<UniqueFd> Doorbells::connect_to(const UniqueFd& way, const std::string& name) const {
  return way ? connect_doorbell("/proc/self/fd", std::to_string(way.get()))
             : connect_doorbell(directory_, name);
}

void Doorbells::remove_unknown_names() noexcept {
  const std::unique_ptr<DIR, int (*)(DIR*)> entries(::opendir(directory_.c_str()), &::closedir);
  if (entries == nullptr) return;
  std::set<std::string> known;
  for (const auto& [key, doorbell] : doorbells_) known.insert(name_of(key));
  while (const dirent* const entry = ::readdir(entries.get())) {
    if (entry->d_name[0] != '.' && known.count(entry->d_name) == 0)
      ::unlinkat(::dirfd(entries.get()), entry->d_name, 0);
  }
}

Result<std::vector<SharedFd>> Doorbells::for_publisher(ClientIndex client, std::uint64_t wait_set,
                                                       bool same_user) {
  const Key key{number(client), wait_set};
  std::vector<SharedFd> fds;
  const auto found = doorbells_.find(key);
  if (found == doorbells_.end()) return fds;
  Entry& doorbell = found->second;
  auto sender = connect_to(doorbell.way, name_of(key));
  note(doorbell, sender);
  // Its name was removed before this daemon began. Publishers of the same user ring the eventfd.
  if (!sender && !doorbell.way && same_user) sender = make_mute_doorbell();
  if (!sender && is_shortage(sender.error().os_errno)) return tl::unexpected(sender.error());
  if (!sender) return fds;
  if (same_user) fds.push_back(doorbell.eventfd);
  fds.push_back(share(std::move(*sender)));
  return fds;
}

void Doorbells::ring(ClientIndex client, std::uint64_t wait_set) noexcept {
  const auto found = doorbells_.find({number(client), wait_set});
  if (found != doorbells_.end()) found->second.own.ring();
}

void Doorbells::ring_all() noexcept {
  for (auto& [key, doorbell] : doorbells_) doorbell.own.ring();
}

void Doorbells::close(ClientIndex client, std::uint64_t wait_set) noexcept {
  const Key key{number(client), wait_set};
  if (doorbells_.erase(key) == 0) return;
  ::unlink((directory_ + "/" + name_of(key)).c_str());
  store_.remove(DescriptorStore::eventfd(client, wait_set));
}

void Doorbells::close_client(ClientIndex client) noexcept {
  const auto begin = doorbells_.lower_bound({number(client), 0});
  const auto end = doorbells_.lower_bound({number(client) + 1, 0});
  for (auto at = begin; at != end; ++at) {
    AGNOCAST_CRASH_POINT(B_doorbell_remove);
    ::unlink((directory_ + "/" + name_of(at->first)).c_str());
    store_.remove(DescriptorStore::eventfd(client, at->first.second));
  }
  doorbells_.erase(begin, end);
}

}  // namespace agnocast::daemon
