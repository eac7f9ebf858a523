// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge's DDS entities wait, refuse and keep within their limits.
// Method: as dds_test.cpp.

#include <tests/integration/bridge/dds/dds_fixture.hpp>

namespace agnocast::test {
namespace {

TEST(Wait, NamesTheReadersThatHaveSamplesUntilTheyAreTaken) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const auto from = writer(*left, "rt/b");
  const auto quiet = reader(*right, "rt/a");
  const auto to = reader(*right, "rt/b");
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  ASSERT_EQ(send(*from, pattern(1)).value(), WriteOutcome::sent);
  ASSERT_EQ(send(*from, pattern(2)).value(), WriteOutcome::sent);
  for (int left_to_take = 2; left_to_take > 0; --left_to_take) {
    std::vector<DdsReader*> ready;
    ASSERT_TRUE(until(*right, [&] {
      const auto got = right->wait(1s).value();
      ready.assign(got.readers.begin(), got.readers.end());
      return !ready.empty();
    }));
    ASSERT_EQ(ready, std::vector<DdsReader*>{to.get()});
    ASSERT_TRUE(to->take());
  }
  (void)right->discovered();
  EXPECT_TRUE(right->wait(0s).value().readers.empty());
}

TEST(Wait, EndsWhenAnotherThreadInterruptsIt) {
  const Domain domain;
  const auto participant = domain.participant();
  participant->interrupt();
  EXPECT_TRUE(participant->wait(patience).value().interrupted);
  EXPECT_FALSE(participant->wait(0s).value().interrupted);
  std::thread other([&] { participant->interrupt(); });
  EXPECT_TRUE(until(*participant, [&] { return participant->wait(patience).value().interrupted; }));
  other.join();
}

TEST(Refusals, AreFailuresWithAText) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto made = participant->create_writer("rt/a b", raw_type, {});
  ASSERT_FALSE(made);
  EXPECT_EQ(made.error().text(), "create a topic: Bad Parameter");
  EXPECT_FALSE(participant->create_reader("DCPSTopic", raw_type, {}, keep_bytes));
}

TEST(Limits, AnUnreadReaderKeepsOneMessageAndNoMoreBytesThanItMay) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const auto from = writer(*left, "rt/a", "reliable all");
  const auto to =
      right->create_reader("rt/a", raw_type, qos_of("reliable all"), keep_bytes, 8 * 1024).value();
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  const auto have_come = [&](std::uint64_t decoded, std::uint64_t overflow) {
    return until(*right, [&] { return to->decoded() + to->overflow() == decoded + overflow; }) &&
           to->decoded() == decoded && to->overflow() == overflow &&
           right->limits().refused(bridge::Limit::unread_bytes_of_reader) == overflow;
  };
  const auto take_all = [&] {
    int count = 0;
    while (to->take()) ++count;
    return count;
  };
  for (int i = 0; i < 12; ++i) ASSERT_TRUE(send(*from, pattern(1020)));
  EXPECT_TRUE(have_come(8, 4)) << to->decoded() << ' ' << to->overflow();
  EXPECT_EQ(take_all(), 8);
  ASSERT_TRUE(send(*from, pattern(20'000)));
  ASSERT_TRUE(send(*from, pattern(0)));
  EXPECT_TRUE(have_come(9, 5)) << "one message of any size where nothing is unread";
  EXPECT_EQ(take_all(), 1);
  // However small, each counts as one KiB.
  for (int i = 0; i < 12; ++i) ASSERT_TRUE(send(*from, pattern(0)));
  EXPECT_TRUE(have_come(17, 9)) << to->decoded() << ' ' << to->overflow();
}

TEST(Limits, FloodedReadersLeaveRoomForOneMessageToEachOther) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const Bytes large(60 * bridge::mebibyte);
  const auto nothing = [](bridge::RawPieces) { return std::make_shared<int>(); };
  std::vector<std::unique_ptr<DdsReader>> readers;
  // 240 MiB each for the first two; for each of the others its first message.
  for (const auto& [topic, decoded] :
       {std::pair("rt/a", 4u), {"rt/b", 4u}, {"rt/c", 1u}, {"rt/d", 1u}}) {
    SCOPED_TRACE(topic);
    const auto from = writer(*left, topic, "reliable 1");
    readers.push_back(reader(*right, topic, "reliable all", raw_type, nothing));
    DdsReader& to = *readers.back();
    ASSERT_TRUE(until(*right, [&] { return to.matched() > 0 && from->matched() > 0; }));
    for (std::uint64_t i = 1; i <= 5; ++i) {
      ASSERT_TRUE(send(*from, large));
      ASSERT_TRUE(until(*right, [&] { return to.decoded() + to.overflow() == i; }));
    }
    EXPECT_EQ(to.decoded(), decoded);
  }
  EXPECT_EQ(right->limits().refused(bridge::Limit::unread_bytes_of_reader), 2u);
  EXPECT_EQ(right->limits().refused(bridge::Limit::unread_bytes), 8u);
  // Taking messages makes room.
  readers.clear();
  const auto from = writer(*left, "rt/c", "reliable 1");
  const auto to = reader(*right, "rt/c", "reliable all", raw_type, nothing);
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  for (std::uint64_t i = 1; i <= 4; ++i) {
    ASSERT_TRUE(send(*from, large));
    ASSERT_TRUE(until(*right, [&] { return to->decoded() == i; }));
  }
}

std::size_t entries_in(const char* directory) {
  DIR* const open = ::opendir(directory);
  std::size_t count = 0;
  while (::readdir(open) != nullptr) ++count;
  ::closedir(open);
  return count;
}
std::size_t resident_kib() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("VmRSS:")) return std::stoul(line.substr(6));
  return 0;
}

TEST(Endpoints, TwoThousandComeAndGoAndLeaveNothing) {
  // Unbounded growth should fail here instead of using all of the machine's memory.
  const rlimit addresses{rlim_t{8} << 30, RLIM_INFINITY};
  ASSERT_EQ(::setrlimit(RLIMIT_AS, &addresses), 0);
  const Domain domain;
  const auto participant = domain.participant(), other = domain.participant();
  const auto many = [&](int count) {
    std::vector<std::unique_ptr<DdsWriter>> writers;
    std::vector<std::unique_ptr<DdsReader>> readers;
    for (int i = 0; i < count / 2; ++i) {
      const std::string topic = "rt/topic_" + std::to_string(i);
      writers.push_back(writer(*participant, topic));
      readers.push_back(reader(*participant, topic));
    }
    EXPECT_TRUE(
        until(*other, [&] { return other->remotes().size() > static_cast<std::size_t>(count); }));
    writers.clear();
    readers.clear();
    EXPECT_TRUE(until(*other, [&] { return other->remotes().size() == 1; }));
  };
  many(2000);
  const std::size_t descriptors = open_descriptor_count(), threads = entries_in("/proc/self/task");
  const std::size_t before_kib = resident_kib();
  many(2000);
  many(2000);
  EXPECT_EQ(open_descriptor_count(), descriptors);
  EXPECT_EQ(entries_in("/proc/self/task"), threads);
  // 4,000 leaked endpoints would exceed 20 MB.
  EXPECT_LT(resident_kib(), before_kib + 8 * 1024);
}

}  // namespace
}  // namespace agnocast::test
