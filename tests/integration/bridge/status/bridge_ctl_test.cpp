// SPDX-License-Identifier: Apache-2.0
//
// Goal: a bridge reports its routes and what it lacks, agnocast-ctl bridge shows it, and neither
// is held up or misled by the other end of the socket. Method: the real agnocastd, agnocast-bridge
// and agnocast-ctl; this process has the agnocast endpoints and is the other participant in DDS;
// the test's own sockets replace a bridge's and lie.

#include <tests/integration/bridge/status/bridge_ctl.hpp>

namespace agnocast::bridge {
namespace {

TEST_F(BridgeCtl, ShowsOutgoingAndIncomingTopics) {
  const auto running = bridge(domain->id());
  const auto reader = reads(topic(), string_type, true);
  auto publisher = create_publisher<String>(PlainNode(), topic(), 50);
  auto subscription = create_subscription<String>(PlainNode(), topic() + "_in", 50);
  const auto writer = participant_->create_writer("rt" + topic() + "_in", string_type, {}).value();
  ASSERT_TRUE(soon([&] { return reader->matched() == 1 && writer->matched() == 1; }));
  for (int i = 0; i < 20; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = "12345";
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  // The writer matches before the bridge's participant knows it, so the first ones may be lost.
  ASSERT_TRUE(soon([&] {
    EXPECT_TRUE(writer->write(
        16,
        [](std::span<std::byte> room) {
          const unsigned char bytes[16] = {0, 1, 0, 0, 4, 0, 0, 0, 'a', 'b', 'c', 0};
          std::memcpy(room.data(), bytes, 12);
          return std::size_t{12};
        },
        1));
    const auto in = route_of(topic() + "_in", "in");
    return !in.is_null() && in["messages"] >= 1;
  }));
  // A payload that is no string: its length exceeds the payload.
  ASSERT_TRUE(writer->write(
      8,
      [](std::span<std::byte> room) {
        const unsigned char bytes[8] = {0, 1, 0, 0, 99, 0, 0, 0};
        std::memcpy(room.data(), bytes, 8);
        return std::size_t{8};
      },
      1));
  ASSERT_TRUE(soon([&] {
    const auto out = route_of(topic(), "out"), in = route_of(topic() + "_in", "in");
    return !out.is_null() && out["messages"] == 20 && !in.is_null() && in["malformed"] == 1;
  })) << ctl({"list", "-v"}).out;
  const auto out = route_of(topic(), "out");
  EXPECT_EQ(out["type"], "std_msgs/msg/String");
  EXPECT_EQ(out["endpoints"], 1);
  EXPECT_EQ(out["matched"], 1);
  EXPECT_EQ(out["bytes"], 20 * 14) << "encapsulation, length, letters, zero";
  EXPECT_TRUE(out["last_age_ns"].is_number());
  const auto in = route_of(topic() + "_in", "in");
  EXPECT_EQ(in["endpoints"], 1);
  EXPECT_GE(in["messages"], 1);

  const auto info = ctl({"info", topic(), "-j"}).json();
  ASSERT_EQ(info["bridges"].size(), 1u);
  const auto endpoint = info["bridges"][0]["endpoints"][0];
  EXPECT_EQ(endpoint["node"], "/ns/node");
  EXPECT_EQ(endpoint["qos"]["depth"], 50);
  EXPECT_EQ(info["bridges"][0]["domain"], domain->id());
  const std::string text = ctl({"info", topic().substr(1)}).out;
  EXPECT_THAT(text, HasSubstr("To DDS: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 1 reader, 0 refused"));
  EXPECT_THAT(text, HasSubstr("Messages: 20, 280 B"));
  EXPECT_THAT(ctl({"list"}).out, HasSubstr(topic()));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, SaysWhyATopicOfBothSidesIsNotBridged) {
  const auto running = bridge(domain->id());
  auto other_type = create_publisher<String>(PlainNode(), topic() + "_type", 5);
  auto weak = create_publisher<String>(PlainNode(), topic() + "_qos", QoS(5).best_effort());
  auto alone = create_publisher<String>(PlainNode(), topic() + "_alone", 5);
  const auto reads_other = reads(topic() + "_type", "std_msgs::msg::dds_::Int32_", true);
  const auto reads_strictly = reads(topic() + "_qos", string_type, true);
  ASSERT_TRUE(soon([&] {
    const auto type = lack_of(topic() + "_type", "out"), qos = lack_of(topic() + "_qos", "out");
    return !type.is_null() && type["why"] == "other_type" && !qos.is_null() && qos["why"] == "qos";
  })) << ctl({"list", "-v"}).out;
  EXPECT_THAT(lack_of(topic() + "_type", "out")["detail"].get<std::string>(),
              HasSubstr("std_msgs/msg/Int32"));
  EXPECT_EQ(lack_of(topic() + "_alone", "out")["why"], "no_reader");
  const std::string text = ctl({"list"}).out;
  EXPECT_THAT(text, HasSubstr("reliability or durability do not match"));
  EXPECT_THAT(text, HasSubstr("it has another type in DDS"));
  EXPECT_THAT(text, testing::Not(HasSubstr("it has no reader in DDS")));
  EXPECT_THAT(ctl({"list", "-v"}).out, HasSubstr("it has no reader in DDS"));
  EXPECT_THAT(ctl({"info", topic() + "_qos"}).out, HasSubstr("Not to DDS: reliability"));
}

TEST_F(BridgeCtl, ShowsAServiceOfThisHostWithAClientInDds) {
  const auto running = bridge(domain->id());
  const test::Spun<PlainNode> node;
  const auto service = serve(node);
  const auto client = plain("client");
  ASSERT_TRUE(soon([&] { return client->ask("matched") == "1 1"; }));
  for (int i = 1; i <= 3; ++i) {
    ASSERT_EQ(client->ask("ask " + std::to_string(i) + " 1 2"), "Success");
    ASSERT_TRUE(soon([&] { return client->ask("take") != "none"; }));
  }
  // A truncated one, and one of a client without a reader for responses.
  const auto writer = participant_
                          ->create_writer("rq" + topic() + "Request",
                                          "example_interfaces::srv::dds_::AddTwoInts_Request_", {})
                          .value();
  const auto zeros = [](std::span<std::byte> room) {
    std::fill(room.begin(), room.end(), std::byte{0});
    room[1] = std::byte{1};
    return room.size();
  };
  ASSERT_TRUE(soon([&] { return writer->matched() == 1; }));
  ASSERT_TRUE(writer->write(36, zeros, 1));
  ASSERT_TRUE(soon([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["timed_out"] == 1 && now["responses"] == 3;
  })) << ctl({"list", "-v"}).out;
  const auto reader = participant_
                          ->create_reader("rr" + topic() + "Reply",
                                          "example_interfaces::srv::dds_::AddTwoInts_Response_", {},
                                          [](RawPieces) { return std::make_shared<int>(); })
                          .value();
  ASSERT_TRUE(soon([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["matched"] == 2;
  }));
  ASSERT_TRUE(writer->write(24, zeros, 1));
  ASSERT_TRUE(soon([&] { return service_of(topic())["malformed"] == 1; }));

  const auto now = service_of(topic());
  EXPECT_EQ(now["type"], add_type);
  EXPECT_EQ(now["direction"], "out");
  EXPECT_EQ(now["nodes"], nlohmann::json({"/ns/node"}));
  EXPECT_EQ(now["requests"], 3);
  EXPECT_EQ(now["request_bytes"], 3 * 36) << "encapsulation, id and number, two numbers";
  EXPECT_EQ(now["response_bytes"], 3 * 28);
  EXPECT_EQ(now["refused"], 0);
  EXPECT_EQ(now["forgotten"], 0);
  EXPECT_TRUE(now["last_age_ns"].is_number());
  const auto info = ctl({"info", topic(), "-j"}).json();
  EXPECT_EQ(info["bridges"][0]["services"][0]["reader_guid"], now["reader_guid"]);
  const std::string text = ctl({"info", topic().substr(1)}).out;
  EXPECT_THAT(text, HasSubstr("Service to DDS, server: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 2 clients"));
  EXPECT_THAT(text, HasSubstr("Requests: 3, 108 B"));
  EXPECT_THAT(text, HasSubstr("Dropped: 1 malformed, 0 refused, 1 timed out, 0 forgotten"));
  EXPECT_THAT(ctl({"list"}).out, HasSubstr("RESPONSES"));
  EXPECT_THAT(
      test::run_ctl(daemon->socket_path(), {"--complete", "bridge", "info", topic().substr(0, 4)})
          .out,
      HasSubstr(topic()));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, ShowsAServiceInDdsWithAClientHereAndReportsAMissingOne) {
  const auto running = bridge(domain->id());
  const test::Spun<PlainNode> node;
  const auto client = create_client<AddTwoInts>(node, topic());
  ASSERT_TRUE(soon([&] { return !lack_of(topic(), "in").is_null(); }));
  EXPECT_EQ(lack_of(topic(), "in")["kind"], "service");
  EXPECT_EQ(lack_of(topic(), "in")["why"], "no_server");
  EXPECT_THAT(ctl({"info", topic()}).out,
              HasSubstr("Service not from DDS: it has no server in DDS"));
  EXPECT_THAT(ctl({"list"}).out, testing::Not(HasSubstr(topic())))
      << "a service of one side only is no mistake";
  EXPECT_THAT(ctl({"list", "-v"}).out, HasSubstr(topic()));

  const auto server = plain("server");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto request = client->borrow_loaned_request();
  request->a = 1;
  auto answer = client->async_send_request(std::move(request));
  std::string asked;
  ASSERT_TRUE(soon([&] { return (asked = server->ask("next")) != "none"; }));
  const std::string head = asked.substr(0, asked.find(' ', asked.find(' ') + 1));
  ASSERT_EQ(server->ask("answer " + head + " 1"), "Success");
  ASSERT_EQ(answer.wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(soon([&] {
    const auto now = service_of(topic());
    return !now.is_null() && now["responses"] == 1;
  }));
  const auto now = service_of(topic());
  EXPECT_EQ(now["direction"], "in");
  EXPECT_EQ(now["matched"], 1);
  EXPECT_EQ(now["requests"], 1);
  EXPECT_EQ(now["request_bytes"], 36);
  EXPECT_EQ(now["response_bytes"], 28);
  EXPECT_TRUE(lack_of(topic(), "in").is_null());
  const std::string text = ctl({"info", topic()}).out;
  EXPECT_THAT(text, HasSubstr("Service from DDS, client: /ns/node"));
  EXPECT_THAT(text, HasSubstr("Matched: 1 server"));
  test::judge_json(status_of(socket_of(domain->id())));
}

TEST_F(BridgeCtl, ShowsTheCurrentHistoryAndNodesOfEndpoints) {
  const auto running = bridge(domain->id());
  DdsQos keep_all;
  keep_all.keep_all = true;
  const auto writer = participant_->create_writer("rt" + topic(), string_type, keep_all).value();
  auto first = create_subscription<String>(PlainNode(), topic(), QoS(5).keep_all());
  const auto bridges = [&] {
    const CtlResult said = ctl({"info", topic(), "-j"});
    return said.status == 0 ? said.json()["bridges"] : nlohmann::json::array();
  };
  const auto nodes = [&] {
    const auto all = bridges();
    return all.empty() || all[0]["dds_readers"].empty() ? nlohmann::json()
                                                        : all[0]["dds_readers"][0]["nodes"];
  };
  ASSERT_TRUE(soon([&] {
    const auto all = bridges();
    return !all.empty() && all[0]["endpoints"].size() == 1 && all[0]["dds_readers"].size() == 1;
  }));
  const auto now = bridges()[0];
  EXPECT_EQ(now["endpoints"][0]["qos"]["history"], "keep_all");
  EXPECT_EQ(now["dds_readers"][0]["qos"]["history"], "keep_all");
  EXPECT_EQ(now["dds_readers"][0]["nodes"], nlohmann::json({"/ns/node"}));
  Node other("other", "/ns");
  auto second = create_subscription<String>(other, topic(), QoS(5).keep_all());
  EXPECT_TRUE(soon([&] {
    return nodes() == nlohmann::json({"/ns/node", "/ns/other"});
  })) << nodes();
  first.reset();
  EXPECT_TRUE(soon([&] { return nodes() == nlohmann::json({"/ns/other"}); })) << nodes();
  EXPECT_EQ(bridges()[0]["dds_readers"][0]["guid"], now["dds_readers"][0]["guid"])
      << "it is the same one";
}

TEST_F(BridgeCtl, ShowsTheBridgesOfAllDomainsAndReportsThatThereIsNone) {
  const CtlResult none = ctl({"list"});
  EXPECT_EQ(none.status, 3);
  EXPECT_THAT(none.err, HasSubstr("\nhint: agnocast-bridge --socket " + daemon->socket_path()));
  const Domain second;
  const auto one = bridge(domain->id()), two = bridge(second.id());
  EXPECT_EQ(ctl({"list", "-j"}).json()["bridges"].size(), 2u);
  const auto of_second = ctl({"list", "--domain", std::to_string(second.id()), "-j"}).json();
  ASSERT_EQ(of_second["bridges"].size(), 1u);
  EXPECT_EQ(of_second["bridges"][0]["domain"], second.id());
  EXPECT_EQ(ctl({"list", "--domain", "200"}).status, 3);
  EXPECT_EQ(ctl({"info", "/nowhere"}).status, 4);
}

TEST_F(BridgeCtl, RulesDecideWhichEndpointsDdsSeesAndMayChange) {
  const test::TemporaryDirectory directory;
  const std::string file = directory.path() + "/bridge.toml";
  std::ofstream(file)
      << "default = \"none\"\n"
         "[[topic]]\nname = \"" +
             topic() +
             "\"\ntype = \"std_msgs/msg/String\"\n"
             "always = true\nto_dds = { reliability = \"best_effort\", depth = 3 }\n"
             "from_dds = { durability = \"transient_local\" }\n";
  const auto running = bridge(domain->id(), {"--config", file});
  auto publisher = create_publisher<String>(PlainNode(), topic(), 50);
  auto other = create_publisher<String>(PlainNode(), topic() + "_other", 50);
  const auto reads_other = reads(topic() + "_other", string_type, false);
  const auto in_dds = [&](Remote::Kind kind) -> std::optional<DdsQos> {
    (void)participant_->discovered();
    for (const auto& [guid, remote] : participant_->remotes())
      if (remote.topic == "rt" + topic() && remote.kind == kind) return remote.qos;
    return std::nullopt;
  };
  ASSERT_TRUE(soon([&] {
    return in_dds(Remote::Kind::writer).has_value() && in_dds(Remote::Kind::reader).has_value();
  })) << "`always` does not make both endpoints without peers";
  EXPECT_FALSE(in_dds(Remote::Kind::writer)->reliable);
  EXPECT_TRUE(in_dds(Remote::Kind::reader)->transient_local);
  // An answer may be a few milliseconds old.
  EXPECT_TRUE(soon([&] {
    const CtlResult said = ctl({"info", topic(), "-j"});
    if (said.status != 0) return false;
    const auto endpoints = said.json()["bridges"][0]["endpoints"];
    return endpoints.size() == 1 && endpoints[0]["qos"]["depth"] == 3;
  }));
  EXPECT_EQ(lack_of(topic() + "_other", "out")["why"], "rule");

  std::ofstream(file) << "[[topic]]\nname = \"" + topic() +
                             "\"\nalways = true\n"
                             "direction = \"out\"\nto_dds = { reliability = \"reliable\" }\n";
  ASSERT_EQ(::kill(running->pid(), SIGHUP), 0);
  EXPECT_TRUE(soon([&] {
    const auto writer = in_dds(Remote::Kind::writer);
    return writer && writer->reliable && !in_dds(Remote::Kind::reader);
  }));
  EXPECT_TRUE(soon([&] { return reads_other->matched() == 1; })) << "no rule names it now";
}

}  // namespace
}  // namespace agnocast::bridge
