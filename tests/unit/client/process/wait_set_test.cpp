// SPDX-License-Identifier: Apache-2.0
//
// Goal: a wake-up ends the sleep of a wait set with any number of sessions, including none; and a
// child of fork that destroys its copy changes nothing. Method: real epoll sets and forks, a page
// as the client region, doorbells as the daemon makes them.

#include <client/process/wait_set.hpp>

#include <client/process/forked_child.hpp>
#include <tests/support/processes/child.hpp>

#include <gtest/gtest.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <utility>

namespace agnocast {
namespace {

/// One session: a client region, and the publishers that ring.
struct Session {
  Session()
      : region(static_cast<std::byte*>(::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE,
                                              MAP_SHARED | MAP_ANONYMOUS, -1, 0))),
        eventfd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0)
      std::abort();
    datagram.reset(pair[0]);
    place = std::make_shared<WaitSet::Place>(
        region, 0, DoorbellReceiver(UniqueFd(::dup(eventfd.get())), UniqueFd(pair[1])));
  }
  ~Session() { ::munmap(region, abi::page_bytes); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void ring() const {
    const std::uint64_t one = 1;
    EXPECT_EQ(::write(eventfd.get(), &one, sizeof one), static_cast<ssize_t>(sizeof one));
  }
  bool is_armed() const {
    return SharedMemory::word(region, offsetof(abi::ClientRegionHeader, wait_set)).load() % 2 == 1;
  }

  std::byte* const region;
  UniqueFd eventfd, datagram;
  std::shared_ptr<WaitSet::Place> place;
};

struct Set {
  bool has_news() const {
    epoll_event event{};
    return ::epoll_wait(fd.get(), &event, 1, 0) == 1;
  }
  UniqueFd fd{::epoll_create1(EPOLL_CLOEXEC)};
};

class WaitSetTest : public testing::Test {
 protected:
  static void SetUpTestSuite() { ASSERT_TRUE(recognise_forked_children()); }
  std::shared_ptr<WaitSet> wait_set_ = WaitSet::make().value();
  Set set_;
};

TEST_F(WaitSetTest, IsWokenWithoutAnyPlace) {
  ASSERT_TRUE(wait_set_->add_to(set_.fd.get(), 1, 2));
  EXPECT_FALSE(set_.has_news());
  wait_set_->wake();
  EXPECT_TRUE(set_.has_news());
  EXPECT_FALSE(set_.has_news()) << "one wake-up wakes once";
  wait_set_->remove_from(set_.fd.get());
  wait_set_->wake();
  EXPECT_FALSE(set_.has_news());
}

TEST_F(WaitSetTest, IsWokenByAPlaceThatComesOrGoesIncludingTheLast) {
  const Session first, second;
  ASSERT_TRUE(wait_set_->add_to(set_.fd.get(), 1, 2));
  ASSERT_TRUE(wait_set_->add(&first, first.place));
  EXPECT_TRUE(set_.has_news());
  ASSERT_TRUE(wait_set_->add(&second, second.place));
  EXPECT_TRUE(set_.has_news());
  for (const Session* const session : {&first, &second}) {
    EXPECT_FALSE(set_.has_news());
    session->ring();
    EXPECT_TRUE(set_.has_news());
  }
  for (const Session* const session : {&first, &second}) {
    wait_set_->remove(session);
    EXPECT_TRUE(set_.has_news());
    session->ring();
    EXPECT_FALSE(set_.has_news()) << "the doorbell is not in the set any more";
  }
}

TEST_F(WaitSetTest, EverySetHasEveryDoorbell) {
  const Session session;
  const Set other;
  ASSERT_TRUE(wait_set_->add(&session, session.place));
  ASSERT_TRUE(wait_set_->add_to(set_.fd.get(), 1, 2));
  ASSERT_TRUE(wait_set_->add_to(other.fd.get(), 1, 2));
  while (set_.has_news() || other.has_news()) {
  }
  session.ring();
  EXPECT_TRUE(set_.has_news() && other.has_news());
  wait_set_->wake();
  EXPECT_TRUE(set_.has_news() && other.has_news());
}

// A publisher rings once for each value of the word, so each sleep needs one of its own.
TEST_F(WaitSetTest, IsArmedAnewByEachThreadAndDisarmedByTheLast) {
  const Session session;
  ASSERT_TRUE(wait_set_->add(&session, session.place));
  const auto word = [&] {
    return SharedMemory::word(session.region, offsetof(abi::ClientRegionHeader, wait_set)).load();
  };
  wait_set_->arm();
  const std::uint64_t first = word();
  wait_set_->arm();
  EXPECT_TRUE(session.is_armed());
  EXPECT_NE(word(), first);
  const std::uint64_t second = word();
  wait_set_->disarm();
  EXPECT_EQ(word(), second) << "the other thread sleeps";
  wait_set_->arm();
  EXPECT_TRUE(session.is_armed());
  EXPECT_NE(word(), second);
  wait_set_->disarm();
  wait_set_->disarm();
  EXPECT_FALSE(session.is_armed());
}

TEST_F(WaitSetTest, ADatagramThatOneSetDrainsWakesTheOthers) {
  const Session session;
  const Set other;
  ASSERT_TRUE(wait_set_->add(&session, session.place));
  ASSERT_TRUE(wait_set_->add_to(set_.fd.get(), 1, 2));
  ASSERT_TRUE(wait_set_->add_to(other.fd.get(), 1, 2));
  while (set_.has_news() || other.has_news()) {
  }
  ASSERT_EQ(::send(session.datagram.get(), "", 1, MSG_DONTWAIT), 1);
  ASSERT_TRUE(set_.has_news());
  wait_set_->drain();
  EXPECT_TRUE(other.has_news()) << "it has not looked yet";
}

TEST_F(WaitSetTest, AChildThatDestroysItsCopyLeavesTheParentAsleepWithItsDoorbells) {
  const Session session;
  ASSERT_TRUE(wait_set_->add(&session, session.place));
  ASSERT_TRUE(wait_set_->add_to(set_.fd.get(), 1, 2));
  while (set_.has_news()) {
  }
  wait_set_->arm();
  ASSERT_TRUE(session.is_armed());
  test::Child child([&] {
    wait_set_.reset();
    return 0;
  });
  EXPECT_EQ(child.wait(), 0);
  EXPECT_TRUE(session.is_armed());
  session.ring();
  EXPECT_TRUE(set_.has_news());
  wait_set_->wake();
  EXPECT_TRUE(set_.has_news());
  wait_set_->disarm();
  EXPECT_FALSE(session.is_armed());
}

TEST_F(WaitSetTest, AFailureToMakeAWaitSetIsReported) {
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit none{0, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &none), 0);
  const auto refused = WaitSet::make();
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &before), 0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::os_failure);
  EXPECT_EQ(refused.error().os_errno, EMFILE);
}

}  // namespace
}  // namespace agnocast
