// SPDX-License-Identifier: Apache-2.0
//
// Goal: a request is answered or fails exactly once, also when it is cancelled, when a side ends
// in its own callback, and when a side does not read; bad types and names are refused.
// Method: as service_test.cpp.

#include <tests/integration/services/service_fixture.hpp>

namespace agnocast {
namespace {

// --- exactly once

/// Copying its request, as publish does when it adopts one, runs the test's hook.
struct Trap {
  static inline std::function<void()> on_copy;
  struct Request : SharedMessage {
    Request() = default;
    Request(const Request& other) : note(other.note) { on_copy(); }
    Request& operator=(const Request&) = default;
    SharedString note;
  };
  struct Response : SharedMessage {
    std::uint64_t number = 0;
  };
};

}  // namespace

template <>
struct MessageTraits<Trap::Request> {
  static constexpr const char* name = "tests/srv/Trap_Request";
  static void for_each_pointer(const Trap::Request& request, PointerVisitor& visit) noexcept {
    visit("note", request.note);
  }
};
template <>
struct MessageTraits<Trap::Response> {
  static constexpr const char* name = "tests/srv/Trap_Response";
};

namespace {

TEST_F(Services, ReportAFailedRequestEitherToTheCallerOrToTheCallback) {
  Node server("server");
  Spun<Node> asker("asker");
  auto service = server.create_service<Trap>("trap", [](const ServiceRequest<Trap>&) {});
  auto client = asker.create_client<Trap>("trap");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<void> called;
  auto call = called.get_future();
  int calls = 0;
  // The server ends, and the library abandons the request, during the send, which then fails.
  Trap::on_copy = [&] {
    service.reset();
    EXPECT_TRUE(is_ready_soon(call));
    throw std::string("no");
  };
  auto request = client->borrow_loaned_request();
  {
    const LoanPause private_memory;
    request->note = "a note that is too long to be kept inside of its string";
  }
  const auto sent =
      client->try_async_send_request(std::move(request), [&](const Client<Trap>::SharedFuture&) {
        if (++calls == 1) called.set_value();
      });
  ASSERT_TRUE(sent) << "the callback was called, so the send was not refused";
  EXPECT_FALSE(request) << "the caller no longer has a sent request";
  auto future = sent->future;
  EXPECT_EQ(error_of(future), Errc::no_server);
  EXPECT_EQ(calls, 1);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

TEST_F(Services, RememberRequestsInPrivateMemory) {
  Spun<Node> node("private");
  auto service = node.create_service<Repeat>("private", answer);
  auto client = node.create_client<Repeat>("private");
  ASSERT_TRUE(client->wait_for_service(patience));
  struct Callback {
    std::promise<bool>* is_shared;
    std::array<std::byte, 512> bulk = {};  // too large for the buffer inside a std::function
    void operator()(const Client<Repeat>::SharedFuture&) const {
      is_shared->set_value(agnocast_heaphook()->owns(this) != 0);
    }
  };
  std::promise<bool> is_shared;
  auto open = client->borrow_loaned_request();  // this thread allocates shared memory
  const auto sent = client->async_send_request(ask_for(client, 1), Callback{&is_shared});
  auto answer_is = is_shared.get_future();
  ASSERT_TRUE(is_ready_soon(answer_is));
  EXPECT_FALSE(answer_is.get());
}

// --- cancelling

TEST_F(Services, DropTheResponseToARemovedRequest) {
  Spun<Node> server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("removed", kept.keep());
  auto client = asker.create_client<Repeat>("removed");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto removed = client->async_send_request(ask_for(client, 1));
  auto stays = client->async_send_request(ask_for(client, 2));
  EXPECT_TRUE(client->remove_pending_request(removed));
  EXPECT_FALSE(client->remove_pending_request(removed.request_id)) << "it is gone";
  EXPECT_THROW(removed.get(), std::future_error);
  ASSERT_TRUE(eventually([&] { return kept.count() == 2; }));
  EXPECT_EQ(kept.answer(service, 0), Errc::ok);
  EXPECT_EQ(kept.answer(service, 1), Errc::ok);
  EXPECT_EQ(error_of(stays), Errc::ok);
  EXPECT_EQ(client->get_dropped_response_count(), 1u);
  EXPECT_FALSE(client->remove_pending_request(stays.request_id)) << "it was answered";
}

TEST_F(Services, PruneRequestsAllOrByAge) {
  Spun<Node> server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("pruned", kept.keep());
  auto client = asker.create_client<Repeat>("pruned");
  ASSERT_TRUE(client->wait_for_service(patience));
  bool was_called = false;
  auto old = client->async_send_request(
      ask_for(client, 1), [&](const Client<Repeat>::SharedFuture&) { was_called = true; });
  const auto sent = std::chrono::system_clock::now();
  auto middle = sent;
  while (middle == sent) middle = std::chrono::system_clock::now();
  auto young = client->async_send_request(ask_for(client, 2));
  std::vector<std::int64_t> pruned;
  EXPECT_EQ(client->prune_requests_older_than(middle, &pruned), 1u);
  EXPECT_THAT(pruned, testing::ElementsAre(old.request_id));
  EXPECT_EQ(client->get_pending_request_count(), 1u);
  EXPECT_EQ(client->prune_pending_requests(), 1u);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
  EXPECT_THROW(young.get(), std::future_error);
  EXPECT_FALSE(was_called);
}

TEST_F(Services, AClientThatEndsBreaksItsFuturesAndGetsNoResponse) {
  Spun<Node> server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("left", kept.keep());
  auto client = asker.create_client<Repeat>("left");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_TRUE(eventually([&] { return kept.count() == 1; }));
  client.reset();
  EXPECT_THROW(sent.get(), std::future_error);
  ASSERT_TRUE(eventually([&] { return service->get_client_count() == 0; }));
  EXPECT_EQ(kept.answer(service, 0), Errc::endpoint_gone);
}

// --- ending in a callback

TEST_F(Services, MayEndInTheirOwnCallbacks) {
  Spun<Node> server("server"), asker("asker");
  Service<Repeat>::SharedPtr service;
  std::mutex assigning;
  {
    const std::lock_guard lock(assigning);
    service = server.create_service<Repeat>(
        "suicide",
        [&](const ipc_shared_ptr<const Repeat::Request>&, ipc_shared_ptr<Repeat::Response>&) {
          const std::lock_guard assigned(assigning);
          service.reset();
        });
  }
  auto client = asker.create_client<Repeat>("suicide");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<Errc> called;
  (void)client->async_send_request(ask_for(client, 1), [&](Client<Repeat>::SharedFuture future) {
    client.reset();
    called.set_value(error_of(future));
  });
  auto code = called.get_future();
  ASSERT_TRUE(is_ready_soon(code));
  EXPECT_EQ(code.get(), Errc::no_server);
  const std::lock_guard until_the_callback_has_ended(assigning);
}

// --- limits

TEST_F(Services, ThatDoNotReadCauseAnErrorAtTheSender) {
  Node server("late_server");
  Spun<Node> asker("asker");
  SingleThreadedExecutor nobody_spins;
  nobody_spins.add_node(server);
  auto service = server.create_service<Repeat>("full", answer, 3);
  auto client = asker.create_client<Repeat>("full", 5);
  ASSERT_TRUE(client->wait_for_service(patience));
  std::vector<Client<Repeat>::Future> sent;
  Errc last = Errc::ok;
  for (std::uint64_t value = 0; value < 10 && last == Errc::ok; ++value) {
    auto request = ask_for(client, value);
    auto next = client->try_async_send_request(std::move(request));
    if (next) {
      sent.push_back(std::move(next->future));
    } else {
      last = next.error().code;
      EXPECT_TRUE(request);
    }
  }
  EXPECT_EQ(last, Errc::would_block);
  EXPECT_EQ(sent.size(), 3u) << "the smaller depth";
  EXPECT_EQ(client->get_pending_request_count(), 3u);
  for (auto& future : sent)
    EXPECT_EQ(nobody_spins.spin_until_future_complete(future, patience), FutureReturnCode::SUCCESS)
        << "nothing was overwritten";
}

TEST_F(Services, AClientThatDoesNotReadDelaysNoOther) {
  Spun<Node> server("server"), reads("reads");
  Node sleeps("sleeps");
  Kept kept;
  SingleThreadedExecutor nobody_spins;
  nobody_spins.add_node(sleeps);
  auto service = server.create_service<Repeat>("slow", kept.keep(), 4);
  auto wait_set = sleeps.create_client<Repeat>("slow", 4);
  auto reader = reads.create_client<Repeat>("slow", 4);
  ASSERT_TRUE(wait_set->wait_for_service(patience));
  ASSERT_TRUE(reader->wait_for_service(patience));
  for (std::size_t i = 0; i < 6; ++i) {
    (void)wait_set->async_send_request(ask_for(wait_set, i));
    ASSERT_TRUE(eventually([&] { return kept.count() == i + 1; }));
  }
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(kept.answer(service, i), Errc::ok);
  EXPECT_EQ(kept.answer(service, 4), Errc::would_block);
  auto sent = reader->async_send_request(ask_for(reader, 70));
  ASSERT_TRUE(eventually([&] { return kept.count() == 7; }));
  EXPECT_EQ(kept.answer(service, 6), Errc::ok);
  EXPECT_EQ(error_of(sent), Errc::ok);
  nobody_spins.spin_all(patience);
  EXPECT_EQ(kept.answer(service, 4), Errc::ok) << "now it has read";
  EXPECT_EQ(kept.answer(service, 5), Errc::ok);
}

TEST_F(Services, RefuseImpossibleOptions) {
  Node node("node");
  const auto code = [&](const std::string& name, const QoS& qos) {
    const auto made = try_create_client<Repeat>(node, name, qos);
    return made ? Errc::ok : made.error().code;
  };
  EXPECT_EQ(code("name", QoS(1).best_effort()), Errc::invalid_argument);
  EXPECT_EQ(code("name", QoS(1).transient_local()), Errc::invalid_argument);
  EXPECT_EQ(code("name", QoS(0)), Errc::depth_refused);
  EXPECT_EQ(code("a b", QoS(1)), Errc::invalid_name);
  EXPECT_EQ(code(std::string(service_name_length_max - 1, 'a'), QoS(1)), Errc::ok);
  EXPECT_EQ(code(std::string(service_name_length_max, 'a'), QoS(1)), Errc::invalid_name);
  const auto topic = try_create_publisher<Repeat::Request>(node, "/_service/request/name", 1);
  ASSERT_FALSE(topic);
  EXPECT_EQ(topic.error().code, Errc::invalid_name);
  EXPECT_THAT(text_of(topic.error()), testing::HasSubstr("are reserved for services"));
}

TEST_F(Services, OfAnotherTypeAreRefusedAlsoWhenOnlyTheResponseDiffers) {
  Node node("node");
  auto service = node.create_service<Repeat>("typed", answer);
  const auto client = try_create_client<Count>(node, "typed");
  ASSERT_FALSE(client);
  EXPECT_EQ(client.error().code, Errc::type_mismatch);
}

// --- names

TEST_F(Services, AreRemappedByTheCommandLine) {
  const char* const line[] = {"program", "--ros-args",        "-r", "both:=b",
                              "-r",      "rosservice://s:=t", "-r", "rostopic://o:=p"};
  init(8, line);
  Node node("node");
  EXPECT_EQ(node.resolve_service_name("both"), "/b");
  EXPECT_EQ(node.resolve_topic_name("both"), "/b");
  EXPECT_EQ(node.resolve_service_name("s"), "/t");
  EXPECT_EQ(node.resolve_topic_name("s"), "/s");
  EXPECT_EQ(node.resolve_service_name("o"), "/o");
  EXPECT_EQ(node.resolve_topic_name("o"), "/p");
  EXPECT_EQ(node.resolve_service_name("~/own"), "/node/own");
  const char* const none[] = {"program"};
  init(1, none);
}

TEST(ServiceNames, DistinguishTopicsOfServicesFromOthers) {
  using Kind = TopicRole::Kind;
  const TopicRole request = role_of_topic(request_topic("/ns/name"));
  EXPECT_EQ(request.kind, Kind::request);
  EXPECT_EQ(request.service, "/ns/name");
  const TopicRole reply = role_of_topic(reply_topic("/ns/name", 0x0123456789abcdef));
  EXPECT_EQ(reply.kind, Kind::reply);
  EXPECT_EQ(reply.service, "/ns/name");
  EXPECT_EQ(reply.client, 0x0123456789abcdefu);
  EXPECT_EQ(role_of_topic(reply_topic("/s", ~std::uint64_t{0})).client, ~std::uint64_t{0});
  for (const char* const topic :
       {"", "/", "/points", "/_service", "/_service/request", "/_service/request/",
        "/_service/requests", "/_service/reply/c0123", "/_service/reply/c0123456789abcdef",
        "/_service/reply/c0123456789abcdeg/a", "/_service/reply/c0123456789abcdeF/a",
        "/_service/reply/c0X23456789abcdef/a", "/_service/reply/c+123456789abcde/a",
        "/_service/reply/c0123456789abcdefa", "/ns/_service/request/a"}) {
    EXPECT_EQ(role_of_topic(topic).kind, Kind::topic) << topic;
    EXPECT_EQ(role_of_topic(topic).service, "") << topic;
  }
}

}  // namespace
}  // namespace agnocast
