// SPDX-License-Identifier: Apache-2.0
//
// Goal: the table counts each user's peers correctly, however they come and go. Method: peers
// without sockets.

#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/errands.hpp>
#include <tests/unit/daemon/admission/users.hpp>

#include <gtest/gtest.h>

#include <memory>
#include <utility>

namespace agnocast::daemon {
namespace {

class ConnectionTableTest : public ::testing::Test {
 protected:
  ConnectionTableTest()
      : dispatcher_(std::move(Dispatcher::create().value())),
        errands_(std::move(Errands::create(dispatcher_).value())),
        disposal_(*errands_),
        table_(dispatcher_, disposal_) {}

  Peer& add(std::uint32_t uid, bool detached = false) {
    PeerIdentity identity;
    identity.uid = uid;
    auto peer = std::make_unique<Peer>(
        Peer{table_.next_id(), Session(PacketSocket(), std::move(identity))});
    peer->session.set_may_carry(false);  // no descriptor to close
    peer->detached = detached;
    return table_.add(std::move(peer));
  }

  Dispatcher dispatcher_;
  std::unique_ptr<Errands> errands_;
  Disposal disposal_;
  ConnectionTable table_;
};

TEST_F(ConnectionTableTest, CountsPerUserAndForgetsUsersWithoutPeers) {
  const PeerId first = add(alice).id, second = add(alice).id;
  add(bob);
  EXPECT_EQ(table_.user(alice).clients, 2U);
  EXPECT_EQ(table_.user(bob).clients, 1U);
  table_.remove(first);
  EXPECT_EQ(table_.find(first), nullptr);
  EXPECT_EQ(table_.user(alice).clients, 1U);
  table_.remove(second);
  EXPECT_FALSE(table_.users().contains(alice));
  EXPECT_TRUE(table_.users().contains(bob));
}

TEST_F(ConnectionTableTest, CountsADetachedPeerOnceUntilItIsGone) {
  Peer& peer = add(alice);
  table_.detach(peer);
  table_.detach(peer);
  add(bob, true);
  EXPECT_EQ(table_.detached_count(), 2U);
  EXPECT_EQ(table_.user(alice).detached, 1U);
  EXPECT_EQ(table_.user(alice).clients, 1U);
  table_.remove(peer.id);
  EXPECT_EQ(table_.detached_count(), 1U);
}

TEST_F(ConnectionTableTest, CountsAnObserverInsteadOfAClientAndBack) {
  Peer& peer = add(alice);
  table_.count_as_observer(peer);
  table_.count_as_observer(peer);
  EXPECT_EQ(table_.user(alice).clients, 0U);
  EXPECT_EQ(table_.user(alice).observers, 1U);
  table_.count_as_client(peer);
  table_.count_as_client(peer);
  EXPECT_EQ(table_.user(alice).clients, 1U);
  EXPECT_EQ(table_.user(alice).observers, 0U);
  table_.become_observer(peer);
  EXPECT_EQ(table_.observer_count(), 1U);
  table_.remove(peer.id);
  EXPECT_EQ(table_.observer_count(), 0U);
}

TEST_F(ConnectionTableTest, FindsAClientUntilItsPlaceIsFree) {
  Peer& peer = add(alice);
  EXPECT_EQ(table_.of_client(ClientIndex{7}), nullptr);
  table_.set_client(ClientIndex{7}, &peer);
  EXPECT_EQ(table_.of_client(ClientIndex{7}), &peer);
  table_.set_client(ClientIndex{7}, nullptr);
  EXPECT_EQ(table_.of_client(ClientIndex{7}), nullptr);
  EXPECT_EQ(table_.find(peer.id), &peer);
}

TEST_F(ConnectionTableTest, NeverUsesANumberTwice) {
  const PeerId first = add(alice).id;
  table_.remove(first);
  EXPECT_NE(add(alice).id, first);
}

}  // namespace
}  // namespace agnocast::daemon
