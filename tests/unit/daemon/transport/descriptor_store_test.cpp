// SPDX-License-Identifier: Apache-2.0
//
// Goal: put() sends name and descriptor to the service manager, take() returns each kept
// descriptor once, and descriptors that nothing takes are removed. Method: our own service
// manager, and a child that gets descriptors as LISTEN_FDS.

#include <daemon/transport/descriptor_store.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/unit/daemon/transport/service_manager.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::daemon {
namespace {

TEST(DescriptorStore, KeepsNothingWithoutAManagerAndReportsIt) {
  ::unsetenv("NOTIFY_SOCKET");
  DescriptorStore none;
  EXPECT_FALSE(none.keeps());
  EXPECT_TRUE(none.put("r1", 0));
  none.remove("r1");
  EXPECT_FALSE(none.take("r1"));
  const auto refused = DescriptorStore::of_manager();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::invalid_argument);
}

TEST(DescriptorStore, NamesStoredDescriptorsAndRemovesOnlyExistingOnes) {
  ServiceManager manager;
  auto store = DescriptorStore::of_manager();
  ASSERT_TRUE(store) << store.error().what;
  const UniqueFd event(::eventfd(5, EFD_CLOEXEC));
  ASSERT_TRUE(store->put(DescriptorStore::eventfd(ClientIndex{7}, 3), event.get()));
  const Received put = manager.receive();
  EXPECT_EQ(put.text, "FDSTORE=1\nFDPOLL=0\nFDNAME=e7.3");
  ASSERT_EQ(put.fds.size(), 1u);
  std::uint64_t value = 0;
  EXPECT_EQ(::read(put.fds[0].get(), &value, sizeof value), ssize_t{8});
  EXPECT_EQ(value, 5u);
  store->remove("never");
  store->remove("e7.3");
  EXPECT_EQ(manager.receive().text, "FDSTOREREMOVE=1\nFDNAME=e7.3");
  EXPECT_EQ(DescriptorStore::region(ClientIndex{12}), "r12");
  EXPECT_EQ(DescriptorStore::process(ClientIndex{0}), "p0");
  EXPECT_EQ(DescriptorStore::window(ClientIndex{2047}, 7), "w2047.7");
}

TEST(DescriptorStore, StopsAtTheLimitOfTheManager) {
  ServiceManager manager;
  ::setenv("FDSTORE", "1", 1);
  auto store = DescriptorStore::of_manager();
  ASSERT_TRUE(store);
  const UniqueFd event(::eventfd(0, EFD_CLOEXEC));
  ASSERT_TRUE(store->put("r1", event.get()));
  const auto full = store->put("r2", event.get());
  ASSERT_FALSE(full);
  EXPECT_EQ(full.error().code, Errc::limit_reached);
  store->remove("r1");
  EXPECT_TRUE(store->put("r2", event.get()));
}

TEST(DescriptorStore, ProbesAManagerThatStatesNoLimit) {
  for (const char* said : {"", "0"}) {
    for (const bool keeps : {true, false}) {
      ServiceManager manager;
      said[0] == '\0' ? ::unsetenv("FDSTORE") : ::setenv("FDSTORE", said, 1);
      std::thread answering([&] {
        Received probe = manager.receive();
        EXPECT_EQ(probe.text, "FDSTORE=1\nFDPOLL=0\nFDNAME=agnocastd-probe");
        EXPECT_EQ(probe.fds.size(), 1u);
        if (!keeps) probe.fds.clear();
        EXPECT_EQ(manager.receive().text, "BARRIER=1");
        if (keeps) {
          EXPECT_EQ(manager.receive().text, "FDSTOREREMOVE=1\nFDNAME=agnocastd-probe");
        }
      });
      const auto store = DescriptorStore::of_manager();
      answering.join();
      ASSERT_TRUE(store);
      EXPECT_EQ(store->keeps(), keeps);
      EXPECT_EQ(store->is_refused(), !keeps);
    }
  }
}

TEST(DescriptorStore, TakesEachOnceAndRemovesTheRest) {
  ServiceManager manager;
  EXPECT_TRUE(test::in_own_process([&] {
    // The descriptors of the test program there are not needed here.
    for (const int fd : {3, 4}) {
      const int event = ::eventfd(static_cast<unsigned>(fd), 0);
      ASSERT_GE(event, 0);
      if (event != fd) {
        ASSERT_EQ(::dup2(event, fd), fd);
      }
    }
    ::setenv("LISTEN_FDS", "2", 1);
    ::setenv("LISTEN_PID", std::to_string(::getpid()).c_str(), 1);
    ::setenv("LISTEN_FDNAMES", "board:r9", 1);
    auto store = DescriptorStore::of_manager();
    ASSERT_TRUE(store);
    EXPECT_EQ(std::getenv("LISTEN_FDS"), nullptr)
        << "the variable must not reach children of the daemon";
    EXPECT_TRUE(store->has("board"));
    const UniqueFd board = store->take("board");
    ASSERT_EQ(board.get(), 3);
    EXPECT_NE(::fcntl(3, F_GETFD) & FD_CLOEXEC, 0);
    EXPECT_FALSE(store->take("board"));
    EXPECT_EQ(store->left_over(), std::vector<std::string>{"r9"});
    std::thread answering([&] {
      EXPECT_EQ(manager.receive().text, "FDSTOREREMOVE=1\nFDNAME=r9");
      EXPECT_EQ(manager.receive().text, "BARRIER=1");  // closing its descriptor is the answer
    });
    EXPECT_EQ(store->remove_left_over(), 1u);
    answering.join();
    EXPECT_EQ(store->remove_left_over(), 0u);
    EXPECT_LT(::fcntl(4, F_GETFD), 0) << "it must also be closed here";
  }));
}

}  // namespace
}  // namespace agnocast::daemon
