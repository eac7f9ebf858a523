// SPDX-License-Identifier: Apache-2.0
//
// The DDS layer against real Cyclone DDS: another process with raw endpoints or as a plain program
// with types of idlc, which is killed, stopped or runs.

#include <tests/integration/bridge/dds/dds_fixture.hpp>

namespace agnocast::test {
namespace {

TEST(Raw, BytesArriveEqualAndInTheFragmentsTheyCameIn) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto down = writer(*participant, "rt/down");
  const auto up = reader(*participant, "rt/up");
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("reader rt/down agnocast_test::msg::dds_::Raw_ reliable 10"), "made");
  ASSERT_EQ(peer->ask("writer rt/up agnocast_test::msg::dds_::Raw_ reliable 10"), "made");
  ASSERT_TRUE(until(*participant, [&] { return down->matched() > 0 && up->matched() > 0; }));
  for (const std::size_t size : {0u, 1u, 3u, 4u, 1000u, 1341u, 65536u, 1u << 20, 8u << 20}) {
    SCOPED_TRACE(size);
    const Bytes bytes = pattern(size);
    peer->tell("echo " + std::to_string(size));
    ASSERT_EQ(send(*down, bytes).value(), WriteOutcome::sent);
    ASSERT_EQ(peer->answer(answer_s), "equal sent");
    const auto sample = next(*participant, *up);
    ASSERT_TRUE(sample);
    const Received& back = received(*sample);
    ASSERT_GE(back.bytes.size(), bytes.size());
    ASSERT_EQ(back.bytes.size() % 4, 0u);
    ASSERT_LT(back.bytes.size() - bytes.size(), 4u);
    EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), back.bytes.begin()));
    EXPECT_TRUE(std::all_of(back.bytes.begin() + std::ptrdiff_t(bytes.size()), back.bytes.end(),
                            [](std::byte byte) { return byte == std::byte{0}; }));
    // A datagram has less than 64 KiB.
    EXPECT_GE(back.pieces, std::max<std::size_t>(1, bytes.size() / 65536));
    EXPECT_TRUE(sample->writer.is_known());
    EXPECT_FALSE(sample->writer.is_of_participant(participant->guid()));
  }
}

TEST(Raw, WriterAndSourceTimeTravelWithTheSample) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const auto from = writer(*left, "rt/a");
  const auto to = reader(*right, "rt/a");
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  constexpr std::int64_t stamp_ns = 1'700'000'000'123'456'789;
  ASSERT_EQ(send(*from, pattern(5), stamp_ns).value(), WriteOutcome::sent);
  const auto sample = next(*right, *to);
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->source_time_ns, stamp_ns);
  EXPECT_EQ(sample->writer, from->guid());
  EXPECT_TRUE(sample->writer.is_of_participant(left->guid()));
}

TEST(Raw, SamplesOfAnEndedWriterStillNameIt) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  auto from = writer(*left, "rt/a");
  const auto to = reader(*right, "rt/a");
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  const bridge::Guid guid = from->guid();
  ASSERT_EQ(send(*from, pattern(5)).value(), WriteOutcome::sent);
  from.reset();
  ASSERT_TRUE(until(*right, [&] { return to->matched() == 0; }));
  const auto sample = to->take();
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->state, DdsSample::State::valid);
  EXPECT_EQ(sample->writer, guid);
}

TEST(Raw, TheLastWritersEndIsASampleWithoutData) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  auto from = writer(*left, "rt/a");
  const auto to = reader(*right, "rt/a");
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  ASSERT_EQ(send(*from, pattern(5)).value(), WriteOutcome::sent);
  ASSERT_TRUE(next(*right, *to));
  from.reset();
  std::optional<DdsSample> last;
  ASSERT_TRUE(until(*right, [&] { return (last = to->take()).has_value(); }));
  EXPECT_EQ(last->state, DdsSample::State::no_writers);
  EXPECT_EQ(last->object, nullptr);
}

TEST(Raw, RefusedPayloadsAreCountedAndSkipped) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const auto from = writer(*left, "rt/a");
  const auto to = reader(*right, "rt/a", "reliable 10", raw_type,
                         [](bridge::RawPieces pieces) -> std::shared_ptr<void> {
                           const auto first = pieces.front()[4];
                           if (first == std::byte{1}) throw std::runtime_error("no");
                           return first == std::byte{2} ? nullptr : keep_bytes(pieces);
                         });
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  for (const auto hex : {"0001000001", "0001000002", "0001000003", "0001000001"})
    ASSERT_EQ(send(*from, bytes_of(hex)).value(), WriteOutcome::sent);
  const auto sample = next(*right, *to);
  ASSERT_TRUE(sample);
  EXPECT_EQ(received(*sample).bytes, bytes_of("0001000003000000"));
  ASSERT_TRUE(until(*right, [&] { return to->refused() == 3; }));
  EXPECT_EQ(to->decoded(), 1u);
  EXPECT_FALSE(to->take());
}

TEST(Raw, ASampleThatCannotBeFilledIsNotSent) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const auto from = writer(*left, "rt/a");
  const auto to = reader(*right, "rt/a");
  ASSERT_TRUE(until(*right, [&] { return to->matched() > 0 && from->matched() > 0; }));
  const auto try_to = [&](std::size_t size, const bridge::RawFill& fill) {
    return from->write(size, fill, 1).value();
  };
  EXPECT_EQ(try_to(8, [](auto) { return std::size_t{0}; }), WriteOutcome::refused);
  EXPECT_EQ(try_to(8, [](auto) { return std::size_t{9}; }), WriteOutcome::refused);
  EXPECT_EQ(try_to(0, [](auto) { return std::size_t{0}; }), WriteOutcome::refused);
  EXPECT_EQ(try_to(std::size_t{1} << 32, [](auto) { return std::size_t{4}; }),
            WriteOutcome::refused);
  EXPECT_EQ(try_to(8, [](auto) -> std::size_t { throw std::runtime_error("no"); }),
            WriteOutcome::refused);
  // Fewer bytes than measured: the unfilled sample does not leave the process.
  EXPECT_EQ(try_to(4096,
                   [](std::span<std::byte> to_fill) {
                     std::fill_n(to_fill.begin(), 6, std::byte{7});
                     return std::size_t{6};
                   }),
            WriteOutcome::sent);
  const auto sample = next(*right, *to);
  ASSERT_TRUE(sample);
  EXPECT_EQ(received(*sample).bytes, bytes_of("0707070707070000"));
}

TEST(Raw, UnfilledBytesAreZeroOnTheWire) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto down = writer(*participant, "rt/down");
  const auto up = reader(*participant, "rt/up");
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("reader rt/down agnocast_test::msg::dds_::Raw_ reliable 10"), "made");
  ASSERT_EQ(peer->ask("writer rt/up agnocast_test::msg::dds_::Raw_ reliable 10"), "made");
  ASSERT_TRUE(until(*participant, [&] { return down->matched() > 0 && up->matched() > 0; }));
  for (const std::size_t size : {1u, 2u, 3u, 4u, 1341u, 70'001u}) {
    SCOPED_TRACE(size);
    const Bytes bytes = pattern(size);
    peer->tell("echo " + std::to_string(size));
    // More bytes were measured than are filled, and the memory held other data before.
    const auto sent = down->write(
        bytes.size() + 64,
        [&](std::span<std::byte> room) {
          std::fill(room.begin(), room.end(), std::byte{0xee});
          std::copy(bytes.begin(), bytes.end(), room.begin());
          return bytes.size();
        },
        1);
    ASSERT_EQ(sent.value(), WriteOutcome::sent);
    ASSERT_EQ(peer->answer(answer_s), "equal sent");
  }
}

TEST(Raw, OwnWritesAreNotReadBack) {
  const Domain domain;
  const auto own = domain.participant(), other = domain.participant();
  const auto from = writer(*own, "rt/a");
  const auto back = reader(*own, "rt/a");
  const auto there = reader(*other, "rt/a");
  const auto foreign = writer(*other, "rt/a");
  ASSERT_TRUE(until(*own, [&] { return back->matched() > 0 && from->matched() > 0; }));
  ASSERT_TRUE(until(*other, [&] { return there->matched() > 0 && foreign->matched() > 0; }));
  ASSERT_EQ(send(*from, pattern(1)).value(), WriteOutcome::sent);
  ASSERT_TRUE(next(*other, *there));
  ASSERT_EQ(send(*foreign, pattern(2)).value(), WriteOutcome::sent);
  const auto sample = next(*own, *back);
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->writer, foreign->guid());
  EXPECT_FALSE(back->take());
  EXPECT_EQ(back->decoded(), 1u);
}

// The CDR that plain programs send in these tests, written by hand.
Bytes string_cdr(const std::string& text) {
  Bytes bytes = bytes_of("00010000");
  bytes.push_back(std::byte(text.size() + 1));
  bytes.resize(8);
  for (const char c : text) bytes.push_back(std::byte(c));
  bytes.push_back(std::byte{0});
  return bytes;
}
Bytes cloud_cdr(std::size_t size) {
  Bytes bytes = bytes_of(
      "00010000"
      "fbffffff07000000"          // stamp
      "040000006d617000"          // frame_id
      "0100000002000000"          // height, width
      "01000000020000007800"      // one field, its name
      "000004000000"              // padding, offset
      "0700000001000000"          // datatype, padding, count
      "000000000300000006000000"  // is_bigendian, padding, point_step, row_step
  );
  for (int shift = 0; shift < 32; shift += 8) bytes.push_back(std::byte(size >> shift & 0xff));
  const Bytes data = pattern(size);
  bytes.insert(bytes.end(), data.begin() + 4, data.end());
  bytes.push_back(std::byte{1});  // is_dense
  return bytes;
}
/// Removes the padding at the end and the record of its length, which Cyclone's serializer puts
/// into the options.
Bytes body(Bytes bytes, std::size_t size) {
  EXPECT_EQ(bytes.size(), (size + 3) / 4 * 4);
  bytes.resize(size);
  bytes.at(3) = std::byte{0};
  return bytes;
}

TEST(Plain, ProgramsOfCycloneWithTypesOfIdlcUnderstandAndAreUnderstood) {
  const Domain domain;
  const auto participant = domain.participant();
  constexpr auto string_type = "std_msgs::msg::dds_::String_";
  constexpr auto cloud_type = "sensor_msgs::msg::dds_::PointCloud2_";
  const auto to_string = writer(*participant, "rt/toString", "reliable 10", string_type);
  const auto from_string = reader(*participant, "rt/fromString", "reliable 10", string_type);
  const auto to_cloud = writer(*participant, "rt/toCloud", "reliable 10", cloud_type);
  const auto from_cloud = reader(*participant, "rt/fromCloud", "reliable 10", cloud_type);
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("plain", answer_s), "ready");
  ASSERT_TRUE(until(*participant, [&] {
    return to_string->matched() > 0 && to_cloud->matched() > 0 && from_string->matched() > 0 &&
           from_cloud->matched() > 0;
  }));
  // Every length of the padding at the end.
  for (const std::string text : {"abc", "abcd", "abcde", "abcdef"}) {
    SCOPED_TRACE(text);
    ASSERT_EQ(send(*to_string, string_cdr(text)).value(), WriteOutcome::sent);
    EXPECT_EQ(peer->ask("take-string", answer_s), text);
    ASSERT_EQ(peer->ask("send-string " + text, answer_s), "sent");
    const auto sample = next(*participant, *from_string);
    ASSERT_TRUE(sample);
    const Bytes wanted = string_cdr(text);
    EXPECT_EQ(body(received(*sample).bytes, wanted.size()), wanted);
  }
  for (const std::size_t size : {0u, 5u, 70'000u, 3'000'000u}) {
    SCOPED_TRACE(size);
    const Bytes wanted = cloud_cdr(size);
    ASSERT_EQ(send(*to_cloud, wanted).value(), WriteOutcome::sent);
    EXPECT_EQ(peer->ask("take-cloud", answer_s),
              "-5 7 map 1 x 6 " + std::to_string(size) + " equal dense");
    ASSERT_EQ(peer->ask("send-cloud " + std::to_string(size), answer_s), "sent");
    const auto sample = next(*participant, *from_cloud);
    ASSERT_TRUE(sample);
    EXPECT_TRUE(body(received(*sample).bytes, wanted.size()) == wanted);
  }
}

TEST(Plain, WritersAnnounceXcdr1AloneAndNoTypeInformation) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto from = writer(*participant, "rt/a");
  const auto peer = domain.peer();
  EXPECT_EQ(peer->ask("announced rt/a", answer_s), "xcdr1 untyped");
  // A cross-check that the test can detect it: a type of idlc.
  const auto plain = domain.peer();
  ASSERT_EQ(plain->ask("plain", answer_s), "ready");
  EXPECT_EQ(peer->ask("announced rt/fromString", answer_s), "xcdr1 xcdr2 typed");
}

TEST(Qos, MatchesByTheRulesOfDds) {
  const Domain domain;
  const auto left = domain.participant(), right = domain.participant();
  const std::vector<std::string> kinds = {"best", "reliable", "best transient",
                                          "reliable transient"};
  for (const std::string& offered : kinds) {
    for (const std::string& requested : kinds) {
      SCOPED_TRACE(offered + " for " + requested);
      const DdsQos offer = qos_of(offered), request = qos_of(requested);
      const bool is_match = (offer.reliable || !request.reliable) &&
                            (offer.transient_local || !request.transient_local);
      const auto from = writer(*left, "rt/a", offered);
      const auto to = reader(*right, "rt/a", requested);
      ASSERT_TRUE(until(*left, [&] {
        return from->matched() + from->incompatible() > 0 && to->matched() + to->incompatible() > 0;
      }));
      EXPECT_EQ(from->matched(), is_match ? 1u : 0u);
      EXPECT_EQ(to->matched(), is_match ? 1u : 0u);
      EXPECT_EQ(to->incompatible(), is_match ? 0u : 1u);
    }
  }
}

TEST(Qos, TransientLocalKeepsItsDepthForReadersThatComeLater) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto from = writer(*participant, "rt/a", "reliable transient 3");
  for (const std::size_t size : {4u, 8u, 12u, 16u, 20u})
    ASSERT_EQ(send(*from, pattern(size)).value(), WriteOutcome::sent);
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("reader rt/a agnocast_test::msg::dds_::Raw_ reliable transient 10"), "made");
  for (const auto size : {"12", "16", "20"}) EXPECT_EQ(peer->ask("take rt/a", answer_s), size);
}

TEST(Qos, AStoppedReaderBlocksNoWriterForEver) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto last = writer(*participant, "rt/last", "reliable 10");
  const auto all = writer(*participant, "rt/all", "reliable all");
  // Its lease is longer than the test may take.
  const auto peer = domain.peer("300 s");
  ASSERT_EQ(peer->ask("reader rt/last agnocast_test::msg::dds_::Raw_ reliable 10"), "made");
  ASSERT_EQ(peer->ask("reader rt/all agnocast_test::msg::dds_::Raw_ reliable all"), "made");
  ASSERT_TRUE(until(*participant, [&] { return last->matched() > 0 && all->matched() > 0; }));
  ::kill(peer->pid(), SIGSTOP);
  const Bytes large = pattern(400'000);
  // Keep-last drops the oldest.
  for (int i = 0; i < 20; ++i) ASSERT_EQ(send(*last, large).value(), WriteOutcome::sent);
  // Keep-all may not, and refuses a write when too much is unacknowledged.
  int given_up = 0;
  for (int i = 0; i < 5; ++i) given_up += send(*all, large).value() == WriteOutcome::would_block;
  EXPECT_GT(given_up, 0);
  EXPECT_LT(given_up, 5);
  ::kill(peer->pid(), SIGCONT);
  EXPECT_TRUE(
      until(*participant, [&] { return send(*all, pattern(77)).value() == WriteOutcome::sent; }));
  // The refused messages are missing, the sent ones arrive.
  for (; given_up < 5; ++given_up) EXPECT_EQ(peer->ask("take rt/all", answer_s), "400000");
  EXPECT_EQ(peer->ask("take rt/all", answer_s), "80");
}

const RemoteChange* find(const std::vector<RemoteChange>& changes, bool is_there, Remote::Kind kind,
                         const std::string& topic) {
  for (const RemoteChange& change : changes)
    if (change.is_there == is_there && change.remote.kind == kind && change.remote.topic == topic)
      return &change;
  return nullptr;
}

TEST(Discovery, ReportsNewEndpointsWithTheirQosAndEndedOnes) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto own = writer(*participant, "rt/own");
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("writer rt/w agnocast_test::msg::dds_::Raw_ reliable transient 7"), "made");
  ASSERT_EQ(peer->ask("reader rt/r agnocast_test::msg::dds_::Other_ best all"), "made");
  std::vector<RemoteChange> changes;
  const RemoteChange* writer_came = nullptr;
  const RemoteChange* reader_came = nullptr;
  ASSERT_TRUE(until(
      *participant,
      [&] {
        writer_came = find(changes, true, Remote::Kind::writer, "rt/w");
        reader_came = find(changes, true, Remote::Kind::reader, "rt/r");
        return writer_came != nullptr && reader_came != nullptr;
      },
      &changes));
  EXPECT_EQ(writer_came->remote.type, raw_type);
  EXPECT_TRUE(writer_came->remote.qos.reliable);
  EXPECT_TRUE(writer_came->remote.qos.transient_local);
  EXPECT_EQ(writer_came->remote.qos.depth, 7);
  EXPECT_EQ(writer_came->remote.qos.lifespan, DdsQos::infinite);
  EXPECT_EQ(writer_came->remote.qos.user_data, "made for rt/w");
  EXPECT_EQ(reader_came->remote.type, "agnocast_test::msg::dds_::Other_");
  EXPECT_FALSE(reader_came->remote.qos.reliable);
  EXPECT_FALSE(reader_came->remote.qos.transient_local);
  EXPECT_TRUE(reader_came->remote.qos.keep_all);
  EXPECT_EQ(find(changes, true, Remote::Kind::writer, "rt/own"), nullptr);
  const RemoteChange* const other = find(changes, true, Remote::Kind::participant, "");
  ASSERT_NE(other, nullptr);
  EXPECT_EQ(other->remote.qos.user_data, "enclave=/;");
  EXPECT_EQ(writer_came->remote.participant, other->remote.guid);
  EXPECT_TRUE(participant->remotes().contains(writer_came->remote.guid));

  const bridge::Guid guid = writer_came->remote.guid;
  changes.clear();
  ASSERT_EQ(peer->ask("delete rt/w"), "gone");
  const RemoteChange* went = nullptr;
  ASSERT_TRUE(until(
      *participant,
      [&] { return (went = find(changes, false, Remote::Kind::writer, "rt/w")) != nullptr; },
      &changes));
  EXPECT_EQ(went->remote.guid, guid);
  EXPECT_EQ(went->remote.qos.user_data, "made for rt/w");
  EXPECT_EQ(find(changes, false, Remote::Kind::reader, "rt/r"), nullptr);
}

TEST(Discovery, ReportsEndpointsThatCameAndWentBetweenTwoLooks) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto to = reader(*participant, "rt/w");
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask("reader rt/r agnocast_test::msg::dds_::Raw_ reliable 1"), "made");
  ASSERT_TRUE(until(*participant, [&] { return participant->remotes().size() == 2; }));
  // From here on only Cyclone's threads process discovery.
  const auto unseen = [](const auto& condition) {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (!condition() && std::chrono::steady_clock::now() < end) std::this_thread::sleep_for(5ms);
    return condition();
  };
  ASSERT_EQ(peer->ask("writer rt/w agnocast_test::msg::dds_::Raw_ reliable transient 7"), "made");
  ASSERT_TRUE(unseen([&] { return to->matched() == 1; }));
  ASSERT_EQ(peer->ask("write rt/w 4"), "sent");
  ASSERT_TRUE(unseen([&] { return to->decoded() == 1; }));
  ASSERT_EQ(peer->ask("delete rt/w"), "gone");
  ASSERT_TRUE(unseen([&] { return to->matched() == 0; }));
  std::vector<RemoteChange> changes;
  const RemoteChange* went = nullptr;
  ASSERT_TRUE(until(
      *participant,
      [&] { return (went = find(changes, false, Remote::Kind::writer, "rt/w")) != nullptr; },
      &changes));
  const RemoteChange* const came = find(changes, true, Remote::Kind::writer, "rt/w");
  ASSERT_NE(came, nullptr);
  EXPECT_LT(came, went);
  EXPECT_EQ(came->remote, went->remote);
  EXPECT_EQ(went->remote.type, raw_type);
  EXPECT_EQ(went->remote.qos.depth, 7);
  EXPECT_FALSE(participant->remotes().contains(went->remote.guid));
  const auto sample = to->take();
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->writer, went->remote.guid);
}

TEST(Discovery, ForgetsTheEndpointsOfAKilledProcessWhenItsLeaseEnds) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto to = reader(*participant, "rt/w");
  const auto peer = domain.peer("1 s");
  ASSERT_EQ(peer->ask("writer rt/w agnocast_test::msg::dds_::Raw_ reliable 1"), "made");
  ASSERT_EQ(peer->ask("reader rt/r agnocast_test::msg::dds_::Raw_ reliable 1"), "made");
  ASSERT_TRUE(until(*participant, [&] {
    return to->matched() > 0 &&
           std::any_of(participant->remotes().begin(), participant->remotes().end(),
                       [](const auto& remote) { return remote.second.topic == "rt/r"; });
  }));
  peer->kill();
  std::vector<RemoteChange> changes;
  ASSERT_TRUE(until(
      *participant, [&] { return participant->remotes().empty(); }, &changes));
  EXPECT_NE(find(changes, false, Remote::Kind::writer, "rt/w"), nullptr);
  EXPECT_NE(find(changes, false, Remote::Kind::reader, "rt/r"), nullptr);
  EXPECT_NE(find(changes, false, Remote::Kind::participant, ""), nullptr);
  EXPECT_TRUE(until(*participant, [&] { return to->matched() == 0; }));
}

}  // namespace
}  // namespace agnocast::test
