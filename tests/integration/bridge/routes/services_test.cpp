// SPDX-License-Identifier: Apache-2.0
//
// Goal: a server of this host answers a client in DDS as one of ROS 2 would, and the other way
// round, each with its own responses. Method: plain_service, C of Cyclone DDS with types of idlc,
// in the form of rmw_cyclonedds.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <agnocast/agnocast.hpp>
#include <bridge/dds/ros_graph.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>

#include <gmock/gmock.h>

#include <csignal>
#include <cstring>
#include <optional>
#include <set>
#include <sstream>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using example_interfaces::srv::AddTwoInts;
using Answer = Client<AddTwoInts>::SharedResponse;

class ServiceBridge : public BridgeTest {
 protected:
  std::unique_ptr<SteeredProcess> plain(const std::string& role, std::uint64_t id) {
    return plain(role, id, topic());
  }
  std::unique_ptr<SteeredProcess> plain(const std::string& role, std::uint64_t id,
                                        const std::string& service) {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_PLAIN_SERVICE, std::to_string(domain->id()), role,
                                 service, std::to_string(id)},
        std::vector<std::string>{});
  }
  std::string say(SteeredProcess& process, const std::string& line) {
    std::string text = "none";
    (void)other_.eventually([&] { return (text = process.ask(line)) != "none"; });
    return text;
  }
  bool is_matched(SteeredProcess& process) {
    return other_.eventually([&] { return process.ask("matched") == "1 1"; });
  }
  static void add(const ipc_shared_ptr<const AddTwoInts::Request>& request,
                  ipc_shared_ptr<AddTwoInts::Response>& response) {
    response->sum = request->a + request->b;
  }
  auto serve() { return create_service<AddTwoInts>(node_, topic(), add); }
  /// Lets the server answer the next request; returns the request.
  std::string serve_one(SteeredProcess& server) {
    const std::string request = say(server, "next");
    std::istringstream words(request);
    std::uint64_t client = 0;
    std::int64_t number = 0, a = 0, b = 0;
    words >> client >> number >> a >> b;
    EXPECT_EQ(server.ask("answer " + std::to_string(client) + ' ' + std::to_string(number) + ' ' +
                         std::to_string(a + b)),
              "Success");
    return std::to_string(a) + ' ' + std::to_string(b);
  }
  static auto send(Client<AddTwoInts>& client, std::int64_t a, std::int64_t b) {
    auto request = client.borrow_loaned_request();
    request->a = a;
    request->b = b;
    return client.async_send_request(std::move(request));
  }

  Spun<PlainNode> node_;
};

TEST_F(ServiceBridge, AServerHereAnswersAClientInDds) {
  const auto service = serve();
  const auto client = plain("client", 4711);
  ASSERT_TRUE(is_matched(*client));
  for (int i = 1; i <= 50; ++i) {
    ASSERT_EQ(client->ask("ask " + std::to_string(i) + " 1000000000000 " + std::to_string(-i)),
              "Success");
    EXPECT_EQ(say(*client, "take"),
              std::to_string(i) + ' ' + std::to_string(1'000'000'000'000 - i));
  }
}

TEST_F(ServiceBridge, AnswersARequestThatComesTogetherWithItsClient) {
  const auto service = serve();
  for (std::uint64_t id = 1; id <= 5; ++id) {
    const auto client = plain("client", id);
    // Like rclcpp: it sends a request as soon as both ends are matched.
    ASSERT_TRUE(is_matched(*client));
    ASSERT_EQ(client->ask("ask 1 2 3"), "Success");
    EXPECT_EQ(say(*client, "take"), "1 5") << id;
  }
}

/// A client in DDS that requests `number` + 1'000'000 under each number, and keeps the responses.
class Many {
 public:
  Many(Other& other, const std::string& topic, std::int64_t count)
      : other_(other),
        answers_(other.reads("rr" + topic + "Reply",
                             "example_interfaces::srv::dds_::AddTwoInts_Response_", deep(count))),
        requests_(other.writes("rq" + topic + "Request",
                               "example_interfaces::srv::dds_::AddTwoInts_Request_", deep(count))) {
  }
  bool is_matched() {
    return other_.eventually([&] { return requests_.matched() == 1 && answers_.matched() == 1; });
  }
  // As its type defines: encapsulation, id and number, then two numbers, or one.
  void ask(std::int64_t number) {
    const std::int64_t words[] = {77, number, number, 1'000'000};
    Bytes request(4 + sizeof words);
    request[1] = std::byte{1};
    std::memcpy(request.data() + 4, words, sizeof words);
    const auto sent = test::send(requests_, request);
    ASSERT_TRUE(sent && *sent == bridge::WriteOutcome::sent) << number;
  }
  /// Returns whether this many arrive in the end.
  bool has_answers(std::size_t count) {
    return other_.eventually([&] {
      while (const auto sample = answers_.take()) {
        if (sample->state != DdsSample::State::valid) continue;
        std::int64_t words[3];
        std::memcpy(words, received(*sample).bytes.data() + 4, sizeof words);
        EXPECT_EQ(words[0], 77);
        EXPECT_EQ(words[2], words[1] + 1'000'000);
        EXPECT_TRUE(numbers_.insert(words[1]).second) << "twice: " << words[1];
      }
      return numbers_.size() >= count;
    });
  }
  const std::set<std::int64_t>& numbers() const { return numbers_; }

 private:
  static DdsQos deep(std::int64_t count) {
    DdsQos qos;
    qos.depth = static_cast<std::int32_t>(count);
    return qos;
  }
  Other& other_;
  DdsReader& answers_;
  DdsWriter& requests_;
  std::set<std::int64_t> numbers_;
};

TEST_F(ServiceBridge, AnswersABurstThatIsMuchLongerThanTheServersQueue) {
  constexpr std::int64_t count = 1'000;
  const auto service = serve();
  Many many(other_, topic(), count);
  ASSERT_TRUE(many.is_matched());
  for (std::int64_t number = 1; number <= count; ++number)
    ASSERT_NO_FATAL_FAILURE(many.ask(number));
  EXPECT_TRUE(many.has_answers(count))
      << many.numbers().size()
      << " responses; not delivered to the bridge: " << service->get_undelivered_response_count();
}

TEST_F(ServiceBridge, ForgetsNoRequestAsLongAsOthersAreAnswered) {
  constexpr std::int64_t count = 1'200, at_once = 600;
  std::optional<ServiceRequest<AddTwoInts>> first;
  Service<AddTwoInts>::SharedPtr service;
  const auto answer = [&](const ServiceRequest<AddTwoInts>& request) {
    auto response = service->borrow_loaned_response();
    response->sum = request->a + request->b;
    EXPECT_TRUE(service->send_response(request, std::move(response)));
  };
  service = create_service<AddTwoInts>(node_, topic(), [&](ServiceRequest<AddTwoInts> now) {
    if (now->a == 1) {
      first = std::move(now);
    } else {
      answer(now);
    }
  });
  Many many(other_, topic(), at_once);
  ASSERT_TRUE(many.is_matched());
  ASSERT_NO_FATAL_FAILURE(many.ask(1));
  for (std::int64_t number = 2; number <= count; ++number) {
    ASSERT_NO_FATAL_FAILURE(many.ask(number));
    if (number % at_once == 0) {
      ASSERT_TRUE(many.has_answers(static_cast<std::size_t>(number - 1)));
    }
  }
  ASSERT_FALSE(many.numbers().contains(1));
  answer(*first);
  EXPECT_TRUE(many.has_answers(count)) << "the first one was forgotten";
}

TEST_F(ServiceBridge, GivesEachClientInDdsItsOwnAnswers) {
  const auto service = serve();
  std::vector<std::unique_ptr<SteeredProcess>> clients;
  for (std::uint64_t id = 1; id <= 3; ++id) {
    clients.push_back(plain("client", id));
    ASSERT_TRUE(is_matched(*clients.back()));
  }
  // The same numbers from all of them, each of which receives all responses.
  for (int i = 1; i <= 8; ++i) {
    const std::string number = std::to_string(i);
    for (std::size_t c = 0; c < clients.size(); ++c)
      ASSERT_EQ(clients[c]->ask("ask " + number + ' ' + std::to_string(100 * c) + ' ' + number),
                "Success");
    for (std::size_t c = 0; c < clients.size(); ++c)
      EXPECT_EQ(say(*clients[c], "take"),
                number + ' ' + std::to_string(100 * static_cast<int>(c) + i));
  }
  for (const auto& client : clients) EXPECT_EQ(client->ask("take"), "none");
}

TEST_F(ServiceBridge, AServerInDdsAnswersAClientHere) {
  const auto client = create_client<AddTwoInts>(node_, topic());
  EXPECT_FALSE(client->service_is_ready());
  const auto server = plain("server", 1);
  ASSERT_TRUE(client->wait_for_service(patience));
  ASSERT_TRUE(is_matched(*server));
  for (int i = 0; i < 20; ++i) {
    auto answer = send(*client, i, 7);
    EXPECT_EQ(serve_one(*server), std::to_string(i) + " 7");
    ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
    EXPECT_EQ(answer.get()->sum, i + 7);
  }
  // Answered in another order.
  auto first = send(*client, 1, 1);
  auto second = send(*client, 2, 2);
  const std::string one = say(*server, "next"), two = say(*server, "next");
  const auto head = [](const std::string& request) {
    return request.substr(0, request.find(' ', request.find(' ') + 1));
  };
  ASSERT_EQ(server->ask("answer " + head(two) + " 22"), "Success");
  ASSERT_EQ(second.wait_for(patience), std::future_status::ready);
  EXPECT_EQ(second.get()->sum, 22);
  EXPECT_EQ(first.wait_for(0s), std::future_status::timeout);
  ASSERT_EQ(server->ask("answer " + head(one) + " 11"), "Success");
  ASSERT_EQ(first.wait_for(patience), std::future_status::ready);
  EXPECT_EQ(first.get()->sum, 11);
}

TEST_F(ServiceBridge, ReportsThatAServerInDdsIsGone) {
  const auto client = create_client<AddTwoInts>(node_, topic());
  auto server = plain("server", 1);
  ASSERT_TRUE(client->wait_for_service(patience));
  auto answer = send(*client, 1, 2);
  ASSERT_NE(say(*server, "next"), "none");
  server.reset();  // SIGKILL: DDS reports it when its lease ends
  ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
  EXPECT_THROW(answer.get(), Error);
  EXPECT_FALSE(client->service_is_ready());
  server = plain("server", 2);
  EXPECT_TRUE(client->wait_for_service(patience));
}

TEST_F(ServiceBridge, LeavesServersAndClientsHereToEachOther) {
  const auto service = serve();
  const auto client = create_client<AddTwoInts>(node_, topic());
  const auto other = plain("client", 1);
  ASSERT_TRUE(is_matched(*other));
  ASSERT_TRUE(client->wait_for_service(patience));
  EXPECT_EQ(client->get_server_count(), 1u) << "the bridge does not count";
  auto answer = send(*client, 3, 4);
  ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
  EXPECT_EQ(answer.get()->sum, 7);
  EXPECT_EQ(client->get_dropped_response_count(), 0u);
}

TEST_F(ServiceBridge, DropsAMalformedRequestAndAnswersTheNext) {
  const auto service = serve();
  const auto client = plain("client", 9);
  ASSERT_TRUE(is_matched(*client));
  DdsWriter& writer = other_.writes("rq" + topic() + "Request",
                                    "example_interfaces::srv::dds_::AddTwoInts_Request_", DdsQos());
  other_.reads("rr" + topic() + "Reply", "example_interfaces::srv::dds_::AddTwoInts_Response_",
               DdsQos());
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  const auto cut = [](std::span<std::byte> room) {
    std::fill(room.begin(), room.end(), std::byte{0});
    room[1] = std::byte{1};
    return room.size();
  };
  ASSERT_TRUE(writer.write(24, cut, 1));
  ASSERT_EQ(client->ask("ask 1 2 3"), "Success");
  EXPECT_EQ(say(*client, "take"), "1 5");
  ASSERT_TRUE(other_.eventually([&] {
    return bridge_log().find("truncated at byte 24") != std::string::npos;
  })) << bridge_log();
}

TEST_F(ServiceBridge, DropsARequestThatCannotBeAnswered) {
  const auto service = serve();
  const auto client = plain("client", 9);
  ASSERT_TRUE(is_matched(*client));
  DdsWriter& writer = other_.writes("rq" + topic() + "Request",
                                    "example_interfaces::srv::dds_::AddTwoInts_Request_", DdsQos());
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  const auto whole = [](std::span<std::byte> room) {
    std::fill(room.begin(), room.end(), std::byte{0});
    room[1] = std::byte{1};
    return room.size();
  };
  ASSERT_TRUE(writer.write(36, whole, 1));
  // No client waits for that.
  ASSERT_EQ(client->ask("ask 1 2 3"), "Success");
  EXPECT_EQ(say(*client, "take"), "1 5");
  ASSERT_TRUE(other_.eventually([&] {
    return bridge_log().find("no route to the server and back") != std::string::npos;
  })) << bridge_log();
}

TEST_F(ServiceBridge, AnnouncesServicesAsRmwCycloneddsExpectsThemUnderTheNodesName) {
  auto graph =
      bridge::RosGraph::create(other_.participant(), bridge::RosGraph::Speak::humble).value();
  const auto service = serve();
  const auto client = plain("client", 1);
  ASSERT_TRUE(is_matched(*client));
  std::string said;
  std::set<Guid> ends;
  ASSERT_TRUE(other_.eventually([&] {
    ends.clear();
    for (const auto& [guid, remote] : other_.participant().remotes()) {
      if ((remote.topic == "rq" + topic() + "Request" && remote.kind == Remote::Kind::reader) ||
          (remote.topic == "rr" + topic() + "Reply" && remote.kind == Remote::Kind::writer)) {
        ends.insert(guid);
        if (said.empty()) said = remote.qos.user_data;
        EXPECT_EQ(remote.qos.user_data, said) << "one id for both";
      }
    }
    return ends.size() == 2;
  }));
  EXPECT_THAT(said, testing::MatchesRegex("serviceid= *1\\.10\\.[0-9a-f.]*;"));
  ASSERT_TRUE(other_.eventually([&] {
    EXPECT_TRUE(graph->update());
    for (const auto& [participant, entities] : graph->others()) {
      for (const auto& node : entities.nodes) {
        std::set<Guid> own(node.readers.begin(), node.readers.end());
        own.insert(node.writers.begin(), node.writers.end());
        if (node.name == "node" && node.name_space == "/ns" && own == ends) return true;
      }
    }
    return false;
  }));
}

TEST_F(ServiceBridge, WaitsOnceForADaemonThatIsStoppedAndHasAllServicesAfterwards) {
  bridge_.reset();
  const std::string status_path =
      testing::TempDir() + "bridge_services-" + std::to_string(::getpid()) + ".sock";
  start_bridge({"--status-socket", status_path});
  const std::string names[] = {topic() + "_a", topic() + "_b"};
  Client<AddTwoInts>::SharedPtr clients[2];
  // As long as nobody in DDS serves it, the status reports that.
  const auto is_missed = [&](const std::string& name, bool expected) {
    return other_.eventually([&] {
      const std::string status = status_at(status_path);
      return !status.empty() && (status.find('"' + name + '"') != std::string::npos) == expected;
    });
  };
  for (int i = 0; i < 2; ++i) {
    clients[i] = create_client<AddTwoInts>(node_, names[i]);
    ASSERT_TRUE(is_missed(names[i], true));
  }
  daemon->kill_worker(SIGSTOP);
  std::unique_ptr<SteeredProcess> servers[2];
  for (int i = 0; i < 2; ++i) {
    servers[i] = plain("server", 1, names[i]);
    EXPECT_TRUE(is_missed(names[i], false));
  }
  EXPECT_EQ(said("what=\"service " + names[0] + '"'), 1u) << bridge_log();
  EXPECT_EQ(said("what=\"service " + names[1] + '"'), 0u) << "the bridge waited for it again";
  daemon->kill_worker(SIGCONT);
  for (int i = 0; i < 2; ++i) {
    ASSERT_TRUE(clients[i]->wait_for_service(patience));
    auto answer = send(*clients[i], 3, 4);
    EXPECT_EQ(serve_one(*servers[i]), "3 4");
    ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
    EXPECT_EQ(answer.get()->sum, 7);
  }
  ::unlink(status_path.c_str());
  ::unlink((status_path + ".lock").c_str());
}

TEST_F(ServiceBridge, MayBeKilledAndGoesOn) {
  const auto service = serve();
  const auto other = plain("client", 1);
  ASSERT_TRUE(is_matched(*other));
  ASSERT_EQ(other->ask("ask 1 1 1"), "Success");
  ASSERT_EQ(say(*other, "take"), "1 2");
  bridge_.reset();  // SIGKILL
  start_bridge();
  // Requests to the dead bridge are lost, as with any server.
  std::int64_t number = 1;
  EXPECT_TRUE(other_.eventually([&] {
    EXPECT_EQ(other->ask("ask " + std::to_string(++number) + " 5 5"), "Success");
    std::this_thread::sleep_for(20ms);
    return other->ask("take") != "none";
  }));
}

}  // namespace
}  // namespace agnocast::test
