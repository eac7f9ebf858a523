// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever arrives, decode() answers without reading beyond the packet, and accepts only
// values inside every table. Method: one honest packet of each kind, one wrong field at a time;
// then seeded random packets, which under AddressSanitizer lie at the end of their allocation.

#include <daemon/transport/request_reading.hpp>

#include <agnocast/abi/fingerprint.hpp>

#include <gtest/gtest.h>

#include <cstring>
#include <random>
#include <vector>

namespace agnocast::daemon {
namespace {

template <class Body>
Body body(wire::Opcode opcode) {
  Body result;
  std::memset(static_cast<void*>(&result), 0, sizeof result);
  result.header = {opcode, sizeof(Body), 77};
  return result;
}
template <class Body>
Request decoded(const Body& packet, const Envelope& envelope = {}, Role role = Role::client) {
  // A heap copy of exactly this length: the sanitizer reports a read one byte beyond it.
  const auto bytes = std::as_bytes(std::span(&packet, 1));
  const std::vector<std::byte> copy(bytes.begin(), bytes.end());
  return decode(copy, envelope, role);
}
Rejected rejected(const Request& request) {
  const auto* const found = std::get_if<Rejected>(&request);
  if (found == nullptr) {
    ADD_FAILURE() << "the packet was accepted";
    return {};
  }
  return *found;
}

wire::CreateEndpoint honest_create(wire::Opcode opcode) {
  auto packet = body<wire::CreateEndpoint>(opcode);
  packet.qos = abi::pack_qos({5, false, true, false, false});
  packet.quota = 3;
  packet.topic = name_of("/a/topic");
  packet.type = name_of("pkg/msg/Type");
  packet.node = name_of("node");
  return packet;
}

TEST(Requests, PassesEveryHonestPacket) {
  EXPECT_TRUE(std::holds_alternative<wire::Hello>(
      decoded(body<wire::Hello>(wire::Opcode::hello), {}, Role::unknown)));
  EXPECT_TRUE(std::holds_alternative<wire::WindowRequest>(
      decoded(body<wire::WindowRequest>(wire::Opcode::open_window))));
  EXPECT_TRUE(std::holds_alternative<WaitSetRequest>(
      decoded(body<wire::WaitSetRequest>(wire::Opcode::open_wait_set))));
  EXPECT_TRUE(std::holds_alternative<wire::Observe>(
      decoded(body<wire::Observe>(wire::Opcode::observe), {}, Role::unknown)));
  EXPECT_TRUE(std::holds_alternative<wire::Dump>(
      decoded(body<wire::Dump>(wire::Opcode::dump), {}, Role::observer)));
  EXPECT_TRUE(std::holds_alternative<wire::WatchGraph>(
      decoded(body<wire::WatchGraph>(wire::Opcode::watch_graph))));
  const Request created = decoded(honest_create(wire::Opcode::create_subscription));
  const auto* const create = std::get_if<CreateRequest>(&created);
  ASSERT_NE(create, nullptr);
  EXPECT_EQ(create->kind, wire::Kind::subscription);
  EXPECT_EQ(create->request, 77u);
  EXPECT_EQ(create->qos.depth, 5u);
  EXPECT_TRUE(create->qos.reliable);
  EXPECT_EQ(create->quota, 3u);
  EXPECT_EQ(create->domain, std::nullopt);
  EXPECT_EQ(create->topic, "/a/topic");
  EXPECT_EQ(create->type, "pkg/msg/Type");
  auto elsewhere = honest_create(wire::Opcode::create_publisher);
  elsewhere.domain = 58;
  const Request of_domain = decoded(elsewhere);
  EXPECT_EQ(std::get<CreateRequest>(of_domain).domain, 57u);
  auto reference = body<wire::Reference>(wire::Opcode::leave);
  reference.kind = wire::Kind::publisher;
  reference.generation = 4;
  EXPECT_TRUE(std::holds_alternative<LeaveRequest>(decoded(reference)));
  reference.header.opcode = wire::Opcode::drained;
  EXPECT_TRUE(std::holds_alternative<DrainedRequest>(decoded(reference)));
  const Request back = decoded(body<wire::Rejoin>(wire::Opcode::rejoin), {}, Role::unknown);
  EXPECT_TRUE(std::holds_alternative<wire::Rejoin>(back));
  auto unlinked = body<wire::Unlinked>(wire::Opcode::unlinked);
  unlinked.kind = wire::Kind::region;
  unlinked.generation = 4;
  EXPECT_TRUE(std::holds_alternative<wire::Unlinked>(decoded(unlinked)));
}

TEST(Requests, TakesAWithdrawalWithAReasonThatItKnows) {
  auto packet = body<wire::Withdrawn>(wire::Opcode::withdrawn);
  packet.publisher_generation = packet.subscription_generation = 4;
  packet.why = static_cast<std::uint32_t>(abi::Withdrawal::over_share);
  EXPECT_TRUE(std::holds_alternative<wire::Withdrawn>(decoded(packet)));
  packet.why = 0;  // served again
  EXPECT_TRUE(std::holds_alternative<wire::Withdrawn>(decoded(packet)));
  packet.why = 4;
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
  packet.why = 1;
  packet.subscription = abi::subscription_count_max;
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
  packet.subscription = 0;
  packet.topic = abi::topic_count_max;
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
}

TEST(Requests, TakesCallbackGroupsWhoseNamesEnd) {
  auto packet = body<wire::CallbackGroup>(wire::Opcode::callback_group);
  EXPECT_TRUE(std::holds_alternative<wire::CallbackGroup>(decoded(packet)));
  std::memset(packet.name.text, 'n', sizeof packet.name.text);
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
  packet.name = {};
  std::memset(packet.node.text, 'n', sizeof packet.node.text);
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
}

TEST(Requests, TakesThreadsThatTheKernelCouldHave) {
  auto packet = body<wire::CallbackThread>(wire::Opcode::callback_thread);
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
  packet.thread = 1;
  EXPECT_TRUE(std::holds_alternative<wire::CallbackThread>(decoded(packet)));
  packet.thread = std::uint32_t{1} << 31;  // a negative number means a process group
  EXPECT_EQ(rejected(decoded(packet)).code, Errc::protocol_violation);
}

TEST(Requests, KeepsTheRepetitionMarkOutOfTheId) {
  auto packet = honest_create(wire::Opcode::create_publisher);
  packet.header.request = 77 | wire::asked_again;
  const Request created = decoded(packet);
  ASSERT_TRUE(std::holds_alternative<CreateRequest>(created));
  EXPECT_TRUE(std::get<CreateRequest>(created).again);
  EXPECT_EQ(std::get<CreateRequest>(created).request, 77u);
  packet.qos.policies = 0;
  EXPECT_EQ(rejected(decoded(packet)).request, 77u);
  packet.header.request = 77;
  packet.qos = honest_create(wire::Opcode::create_publisher).qos;
  EXPECT_FALSE(std::get<CreateRequest>(decoded(packet)).again);
}

TEST(Requests, EndsAConnectionThatCannotBeParsed) {
  EXPECT_TRUE(rejected(decode({}, {}, Role::client)).ends_connection);
  auto packet = body<wire::WindowRequest>(wire::Opcode::open_window);
  const auto bytes = std::as_bytes(std::span(&packet, 1));
  EXPECT_TRUE(rejected(decode(bytes.first(15), {}, Role::client)).ends_connection);
  EXPECT_TRUE(rejected(decode(bytes.first(20), {}, Role::client)).ends_connection)
      << "the length field is false";
  EXPECT_TRUE(rejected(decoded(packet, {0, true, false})).ends_connection) << "too long";
}

TEST(Requests, RefusesParsablePacketsWithWrongContent) {
  auto window = body<wire::WindowRequest>(wire::Opcode::open_window);
  EXPECT_FALSE(rejected(decoded(window, {1, false, false})).ends_connection) << "descriptors";
  EXPECT_EQ(rejected(decoded(window, {1, false, false})).code, Errc::protocol_violation);
  EXPECT_EQ(rejected(decoded(window, {0, false, true})).code, Errc::protocol_violation);
  EXPECT_EQ(rejected(decoded(window, {}, Role::unknown)).text, "the first request must be hello");
  EXPECT_EQ(rejected(decoded(body<wire::Hello>(wire::Opcode::hello))).text,
            "hello may be sent only once");
  window.window = abi::window_count_max;
  EXPECT_EQ(rejected(decoded(window)).code, Errc::window_exhausted);
  EXPECT_EQ(rejected(decoded(window)).request, 77u);
  EXPECT_EQ(rejected(decoded(body<wire::Done>(wire::Opcode::done))).text, "unknown request 105");
  EXPECT_EQ(rejected(decoded(body<wire::Done>(wire::Opcode::open_window))).code,
            Errc::protocol_violation);
  EXPECT_EQ(rejected(decoded(body<wire::Done>(wire::Opcode::hello), {}, Role::unknown)).code,
            Errc::layout_mismatch)
      << "a hello of another version";
  auto executor = body<wire::WaitSetRequest>(wire::Opcode::open_wait_set);
  executor.wait_set = abi::wait_set_count_max;
  EXPECT_EQ(rejected(decoded(executor)).code, Errc::limit_reached);
}

TEST(Requests, AllowsEachRoleOnlyItsRequests) {
  const auto observe = body<wire::Observe>(wire::Opcode::observe);
  const auto dump = body<wire::Dump>(wire::Opcode::dump);
  const auto window = body<wire::WindowRequest>(wire::Opcode::open_window);
  for (const Role role : {Role::client, Role::observer})
    EXPECT_EQ(rejected(decoded(observe, {}, role)).code, Errc::protocol_violation);
  for (const Role role : {Role::client, Role::unknown})
    EXPECT_EQ(rejected(decoded(dump, {}, role)).code, Errc::protocol_violation);
  for (const Role role : {Role::observer, Role::unknown})
    EXPECT_EQ(rejected(decoded(window, {}, role)).code, Errc::protocol_violation);
  EXPECT_EQ(rejected(decoded(window, {}, Role::observer)).text, "an observer may not take part");
}

TEST(Requests, RefusesUnterminatedNames) {
  auto hello = body<wire::Hello>(wire::Opcode::hello);
  std::memset(hello.process_name.text, 'x', sizeof hello.process_name.text);
  EXPECT_EQ(rejected(decoded(hello, {}, Role::unknown)).text,
            "the name of the process does not end");
  for (auto member :
       {&wire::CreateEndpoint::topic, &wire::CreateEndpoint::type, &wire::CreateEndpoint::node}) {
    auto create = honest_create(wire::Opcode::create_publisher);
    std::memset((create.*member).text, 'x', sizeof(wire::Name));
    EXPECT_EQ(rejected(decoded(create)).code, Errc::protocol_violation);
  }
}

TEST(Requests, OnlySubscriptionsIgnoreTheirProcess) {
  auto create = honest_create(wire::Opcode::create_publisher);
  abi::Qos qos = abi::unpack_qos(create.qos);
  qos.ignore_local = true;
  create.qos = abi::pack_qos(qos);
  EXPECT_EQ(rejected(decoded(create)).code, Errc::invalid_argument);
  create.header.opcode = wire::Opcode::create_subscription;
  EXPECT_TRUE(std::get<CreateRequest>(decoded(create)).qos.ignore_local);
}

TEST(Requests, EveryQosPasses) {
  auto create = honest_create(wire::Opcode::create_publisher);
  create.qos = abi::pack_qos({7, true, false, true, false, true, 1, abi::qos_time_max_ns, 3});
  const abi::Qos qos = std::get<CreateRequest>(decoded(create)).qos;
  EXPECT_EQ(qos.depth, 7u);
  EXPECT_TRUE(qos.transient_local && qos.keep_all && qos.manual_liveliness);
  EXPECT_FALSE(qos.reliable || qos.ignore_local);
  EXPECT_EQ(qos.deadline_ns, 1u);
  EXPECT_EQ(qos.lifespan_ns, abi::qos_time_max_ns);
  EXPECT_EQ(qos.lease_ns, 3u);
}

TEST(Requests, RefusesImpossibleEndpoints) {
  const auto with = [](auto change) {
    auto create = honest_create(wire::Opcode::create_subscription);
    change(create);
    return rejected(decoded(create)).code;
  };
  EXPECT_EQ(with([](auto& c) { c.qos.policies = 0; }), Errc::depth_refused);
  EXPECT_EQ(with([](auto& c) { c.qos.policies = abi::depth_max + 1; }), Errc::depth_refused);
  EXPECT_EQ(with([](auto& c) { c.qos.policies |= 1 << 21; }), Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.qos.policies |= std::uint64_t{1} << 63; }),
            Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.qos.deadline_ns = abi::qos_time_max_ns + 1; }),
            Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.qos.lease_ns = ~std::uint64_t{0}; }), Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.qos.lifespan_ns = 1; }), Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.quota = 0; }), Errc::invalid_argument);
  EXPECT_EQ(with([](auto& c) { c.quota = abi::slot_count_max + 1; }), Errc::quota_exceeded);
  EXPECT_EQ(with([](auto& c) { c.wait_set = abi::wait_set_count_max; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& c) { c.type = name_of(""); }), Errc::invalid_argument);
}

TEST(Requests, RefusesReferencesOutsideTheTables) {
  const auto with = [](auto change) {
    auto reference = body<wire::Reference>(wire::Opcode::leave);
    reference.kind = wire::Kind::subscription;
    reference.generation = 1;
    change(reference);
    return rejected(decoded(reference)).code;
  };
  EXPECT_EQ(with([](auto& r) { r.kind = wire::Kind{0}; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) { r.kind = wire::Kind::region; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) { r.topic = abi::topic_count_max; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) { r.index = abi::subscription_count_max; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) {
              r.kind = wire::Kind::publisher;
              r.index = abi::publisher_count_max;
            }),
            Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) { r.generation = 0; }), Errc::protocol_violation);
  EXPECT_EQ(with([](auto& r) { r.generation = std::uint64_t{1} << 48; }), Errc::protocol_violation);
}

// Long because it has an honest example of each kind of packet.
TEST(Requests, SurvivesRandomPackets) {
  std::mt19937_64 random(20260101);
  const wire::Opcode opcodes[] = {wire::Opcode::hello,
                                  wire::Opcode::open_window,
                                  wire::Opcode::open_wait_set,
                                  wire::Opcode::create_publisher,
                                  wire::Opcode::create_subscription,
                                  wire::Opcode::leave,
                                  wire::Opcode::drained,
                                  wire::Opcode::unlinked,
                                  wire::Opcode::rejoin};
  unsigned accepted = 0;
  for (int i = 0; i < 200000; ++i) {
    // Mostly honest packets with a few wrong bytes: pure noise would never get past the length.
    const wire::Opcode opcode = opcodes[random() % std::size(opcodes)];
    std::vector<std::byte> packet;
    const auto take = [&](const auto& example) {
      const auto bytes = std::as_bytes(std::span(&example, 1));
      packet.assign(bytes.begin(), bytes.end());
    };
    switch (random() % 5) {
      case 0:
        packet.resize(random() % (wire::packet_bytes_max + 1));
        for (std::byte& byte : packet) byte = static_cast<std::byte>(random());
        break;
      case 1:
        take(honest_create(opcode));
        break;
      case 2: {
        auto reference = body<wire::Reference>(opcode);
        reference.kind = wire::Kind{static_cast<std::uint32_t>(random() % 4)};
        reference.generation = 1;
        take(reference);
        break;
      }
      case 3: {
        auto unlinked = body<wire::Unlinked>(opcode);
        unlinked.kind = wire::Kind{static_cast<std::uint32_t>(random() % 4)};
        unlinked.generation = 1;
        take(unlinked);
        break;
      }
      default:
        take(body<wire::WindowRequest>(opcode));
        break;
    }
    for (auto wrong = random() % 4; wrong > 0 && !packet.empty(); --wrong)
      packet[random() % packet.size()] = static_cast<std::byte>(random());
    const Request request =
        decode(packet, {random() % 16 == 0 ? 1u : 0u, random() % 16 == 0, false},
               static_cast<Role>(i % 3));
    if (const auto* const create = std::get_if<CreateRequest>(&request)) {
      ++accepted;
      ASSERT_GE(create->qos.depth, 1u);
      ASSERT_LE(create->qos.depth, abi::depth_max);
      ASSERT_LT(create->topic.size(), sizeof(wire::Name));
      if (create->kind == wire::Kind::subscription) {
        ASSERT_LT(create->wait_set, abi::wait_set_count_max);
        ASSERT_LE(create->quota, abi::slot_count_max);
      }
    } else if (const auto* const leave = std::get_if<LeaveRequest>(&request)) {
      ++accepted;
      ASSERT_LT(leave->reference.topic, abi::topic_count_max);
      ASSERT_LT(leave->reference.index, abi::subscription_count_max);
    } else if (const auto* const unlinked = std::get_if<wire::Unlinked>(&request)) {
      ++accepted;
      ASSERT_LT(unlinked->index, abi::client_count_max);
    }
  }
  EXPECT_GT(accepted, 1000u) << "too few random packets reach a handler";
}

TEST(Requests, TruncatesAndTerminatesEveryTextItSends) {
  const wire::Name name = name_of(std::string(1000, 'x'));
  std::string_view text;
  ASSERT_TRUE(text_of(name, text));
  EXPECT_EQ(text.size(), sizeof(wire::Name) - 1);
  EXPECT_EQ(printable("a\nb\x1b[0m\xff"), "a?b?[0m?");
}

}  // namespace
}  // namespace agnocast::daemon
