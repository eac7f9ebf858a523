// SPDX-License-Identifier: Apache-2.0
//
// A hostile participant of DDS, steered line by line: a program of Cyclone DDS that sends raw CDR
// and false announcements. It answers each line when done.
//
//   hostile_peer DOMAIN
//
//   malform TOPIC TYPE               one of each malformed payload → sent COUNT
//   flood TOPIC TYPE QOS BYTES N     N strings of BYTES letters; QOS as in qos_of() → sent COUNT
//   history TOPIC TYPE QOS BYTES N   the same, by a writer that stays → sent COUNT
//   endpoints N                      N writers of topics that nobody else has → made
//   others TOPIC TYPE N              N writers and N readers of that topic → made
//   forget                           deletes all of these → forgotten
//   churn TOPIC TYPE N               a writer that writes and a reader, made and deleted → done
//   nodes                            malformed and huge ros_discovery_info → sent COUNT
//   ask SERVICE N BYTES              N requests of that size, of readerless clients → sent COUNT
//   serve SERVICE                    until the end: a server that answers each request twice,
//                                    and requests of others
//   answered                         how many requests it has answered → COUNT
//   garbage PORT N                   N datagrams to 127.0.0.1: noise, some after an RTPS header

#include <bridge/dds/names.hpp>
#include <tests/integration/bridge/dds/dds_side.hpp>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <atomic>
#include <cstring>
#include <iostream>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

/// A payload, little-endian.
class Cdr {
 public:
  Cdr() : bytes_{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}} {}
  Cdr& u32(std::uint32_t value) {
    while (bytes_.size() % 4 != 0) bytes_.push_back(std::byte{0});
    return raw(&value, sizeof value);
  }
  Cdr& u64(std::uint64_t value) { return raw(&value, sizeof value); }
  Cdr& text(const std::string& text) {
    u32(static_cast<std::uint32_t>(text.size() + 1));
    return raw(text.c_str(), text.size() + 1);
  }
  Cdr& raw(const void* from, std::size_t size) {
    const auto* const bytes = static_cast<const std::byte*>(from);
    bytes_.insert(bytes_.end(), bytes, bytes + size);
    return *this;
  }
  operator const Bytes&() const { return bytes_; }

 private:
  Bytes bytes_;
};

/// Returns payloads that are no message of any type in the tests, in an encapsulation that Cyclone
/// DDS accepts.
std::vector<Bytes> malformed() {
  std::vector<Bytes> all;
  const auto add = [&](const Bytes& bytes) { all.push_back(bytes); };
  add(Bytes(1));
  add(Bytes(4));
  // A length beyond the packet; of nothing; of everything.
  for (const std::uint32_t length : {2U, 100U, 0x7fffffffU, 0xffffffffU}) add(Cdr().u32(length));
  // A string without an end.
  add(Cdr().u32(8).raw("abcdefgh", 8));
  add(Cdr().u32(64).raw(std::string(64, 'x').data(), 64));
  // Sequences of sequences, each of which claims the rest: 2^30, of 2^30, of 2^30.
  Cdr nested;
  for (int i = 0; i < 1'000; ++i) nested.u32(0x40000000);
  add(nested);
  // Counts that are plausible alone, and not together.
  Cdr greedy;
  for (int i = 0; i < 4'000; ++i) greedy.u32(4'001);
  add(greedy);
  std::mt19937 random(7);
  for (std::size_t i = 0; i < 200; ++i) {
    Bytes noise(12 + random() % 2'000);
    for (std::byte& byte : noise) byte = std::byte(random());
    noise[0] = std::byte{0};
    noise[1] = std::byte{1};
    noise[7] |= std::byte{0x80};  // its first length always exceeds it
    noise[11] |= std::byte{0x80};
    all.push_back(noise);
  }
  return all;
}

/// Encapsulations of other kinds, which Cyclone DDS may refuse itself.
std::vector<Bytes> unreadable() {
  std::vector<Bytes> all{Bytes(4, std::byte{0xff})};
  for (const int first : {0, 0x80}) {
    for (int kind = 2; kind < 16; ++kind) {
      Bytes bytes = Cdr().u32(2).raw("a", 2);
      bytes[0] = std::byte(first);
      bytes[1] = std::byte(kind);
      all.push_back(bytes);
    }
  }
  return all;
}

class Attacker {
 public:
  explicit Attacker(std::uint32_t domain)
      : participant_(std::move(DdsParticipant::create({.domain = domain}).value())) {}
  ~Attacker() {
    stops_ = true;
    if (server_.joinable()) server_.join();
  }

  std::string malform(const std::string& topic, const std::string& type) {
    DdsQos qos;
    qos.depth = 1'000;
    const auto writer = participant_->create_writer(topic, type, qos).value();
    wait_for(*writer);
    std::size_t count = 0;
    for (const Bytes& bytes : malformed()) count += send(*writer, bytes).has_value();
    linger();
    qos.reliable = false;
    const auto careless = participant_->create_writer(topic, type, qos).value();
    for (const Bytes& bytes : unreadable()) (void)send(*careless, bytes);
    linger();
    return "sent " + std::to_string(count);
  }

  std::string flood(const std::string& topic, const std::string& type, const DdsQos& qos,
                    std::size_t bytes, std::size_t messages, bool stays) {
    auto writer = participant_->create_writer(topic, type, qos).value();
    wait_for(*writer);
    const Bytes payload = Cdr().text(std::string(bytes, 'f'));
    std::size_t count = 0;
    for (std::size_t i = 0; i < messages; ++i) {
      const auto sent = send(*writer, payload, static_cast<std::int64_t>(i + 1));
      count += sent && *sent == bridge::WriteOutcome::sent;
    }
    if (stays)
      writers_.push_back(std::move(writer));
    else
      linger();
    return "sent " + std::to_string(count);
  }

  std::string endpoints(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      const std::string topic = "rt/hostile_" + std::to_string(i);
      auto made = participant_->create_writer(topic, "a::msg::dds_::B_", {});
      if (!made) return std::to_string(i) + ": " + made.error().text();
      writers_.push_back(std::move(*made));
    }
    return "made";
  }
  std::string others(const std::string& topic, const std::string& type, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      writers_.push_back(participant_->create_writer(topic, type, {}).value());
      readers_.push_back(participant_->create_reader(topic, type, {}, keep_bytes).value());
    }
    return "made";
  }
  std::string forget() {
    writers_.clear();
    readers_.clear();
    return "forgotten";
  }

  std::string churn(const std::string& topic, const std::string& type, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      DdsQos qos;
      qos.transient_local = i % 2 == 0;
      const auto writer = participant_->create_writer(topic, type, qos).value();
      const auto reader = participant_->create_reader(topic, type, qos, keep_bytes).value();
      (void)send(*writer, Cdr().text("churn"), static_cast<std::int64_t>(i + 1));
    }
    return "done";
  }

  std::string nodes() {
    DdsQos qos;
    qos.transient_local = true;
    qos.depth = 1'000;
    const auto writer =
        participant_
            ->create_writer("ros_discovery_info",
                            "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", qos)
            .value();
    wait_for(*writer);
    const auto head = [&](std::uint32_t nodes) {
      Cdr cdr;
      cdr.raw(participant_->guid().bytes.data(), 16);  // Iron's form
      return cdr.u32(nodes);
    };
    std::vector<Bytes> all = malformed();
    all.push_back(head(1'000'000));
    all.push_back(head(0xffffffff));
    // A million complete nodes: 24 bytes each, of which the bridge would read the first 1 MiB.
    Cdr million = head(1'000'000);
    for (int i = 0; i < 1'000'000; ++i) million.text("/").text("n").u32(0).u32(0);
    all.push_back(million);
    // One node with an impossible number of endpoints.
    all.push_back(head(1).text("/").text("n").u32(0x10000000));
    // Claims a node of another participant.
    Cdr impostor;
    Bytes other(16, std::byte{9});
    impostor.raw(other.data(), other.size());
    all.push_back(impostor.u32(1).text("/").text("impostor").u32(0).u32(0));
    // The maximum of one message, all true.
    Cdr many = head(40'000);
    for (int i = 0; i < 40'000; ++i) many.text("/").text("n").u32(0).u32(0);
    all.push_back(many);
    std::size_t count = 0;
    for (const Bytes& bytes : all) count += send(*writer, bytes).has_value();
    linger();
    nodes_ = std::move(const_cast<std::unique_ptr<DdsWriter>&>(writer));
    return "sent " + std::to_string(count);
  }

  std::string ask(const std::string& service, std::size_t count, std::size_t bytes) {
    DdsQos qos;
    qos.depth = 2'000;
    qos.user_data = "clientid=nobody;";
    const auto writer =
        participant_->create_writer(service_topic("rq", service, "Request"), request_type, qos)
            .value();
    wait_for(*writer);
    std::size_t sent = 0;
    for (std::size_t i = 0; i < count; ++i) {
      Cdr request;
      request.u64(77).u64(i).u64(1).u64(2);
      const std::string rest(bytes, 'r');  // after the last member: any bytes may follow there
      request.raw(rest.data(), rest.size());
      sent += send(*writer, request, static_cast<std::int64_t>(i + 1)).has_value();
    }
    linger();
    return "sent " + std::to_string(sent);
  }

  std::string serve(const std::string& service) {
    DdsQos qos;
    qos.depth = 1'000;
    qos.user_data = "serviceid=hostile;";
    auto reader =
        participant_
            ->create_reader(service_topic("rq", service, "Request"), request_type, qos, keep_bytes)
            .value();
    auto writer =
        participant_->create_writer(service_topic("rr", service, "Reply"), response_type, qos)
            .value();
    server_ = std::thread([this, reader = std::move(reader), writer = std::move(writer)] {
      while (!stops_) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        const auto sample = reader->take();
        if (!sample || sample->state != DdsSample::State::valid) continue;
        const Bytes& request = static_cast<Received*>(sample->object.get())->bytes;
        if (request.size() < 36) continue;
        std::uint64_t client = 0, number = 0, a = 0, b = 0;
        std::memcpy(&client, request.data() + 4, 8);
        std::memcpy(&number, request.data() + 12, 8);
        std::memcpy(&a, request.data() + 20, 8);
        std::memcpy(&b, request.data() + 28, 8);
        const auto answer = [&](std::uint64_t to, std::uint64_t which, std::uint64_t sum) {
          (void)send(*writer, Cdr().u64(to).u64(which).u64(sum));
        };
        answer(client + 1, number, 1);           // another client
        answer(client, number + 1'000, 2);       // no client has asked this
        (void)send(*writer, Cdr().u64(client));  // truncated
        answer(client, number, a + b);
        answer(client, number, 3);  // again
        answer(client, number, 4);
        ++answered_;
      }
    });
    return "serves";
  }
  std::string answered() const { return std::to_string(answered_); }

  static std::string garbage(std::uint16_t port, std::size_t count) {
    const int fd = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    std::mt19937 random(port);
    std::vector<std::uint8_t> packet;
    for (std::size_t i = 0; i < count; ++i) {
      packet.resize(random() % (i % 50 == 0 ? 60'000 : 500));
      for (std::uint8_t& byte : packet) byte = static_cast<std::uint8_t>(random());
      if (i % 3 != 0 && packet.size() >= 24) {
        std::memcpy(packet.data(), "RTPS\2\1\1\20", 8);
        // An existing submessage kind, with a length that is nearly right.
        constexpr std::uint8_t kinds[] = {0x01, 0x06, 0x07, 0x08, 0x09, 0x0c,
                                          0x0d, 0x0e, 0x12, 0x13, 0x15, 0x16};
        packet[20] = kinds[random() % sizeof kinds];
        packet[21] |= 1;
        const std::size_t length = packet.size() - 24 + (i % 7 == 0 ? random() % 9 : 0);
        packet[22] = static_cast<std::uint8_t>(length);
        packet[23] = static_cast<std::uint8_t>(length >> 8);
      }
      (void)!::sendto(fd, packet.data(), packet.size(), 0, reinterpret_cast<sockaddr*>(&to),
                      sizeof to);
    }
    ::close(fd);
    return "sent";
  }

 private:
  static constexpr const char* request_type = "example_interfaces::srv::dds_::AddTwoInts_Request_";
  static constexpr const char* response_type =
      "example_interfaces::srv::dds_::AddTwoInts_Response_";
  static std::string service_topic(const char* prefix, const std::string& service,
                                   const char* suffix) {
    return std::string(prefix) + service + suffix;
  }
  void wait_for(const DdsWriter& writer) {
    (void)until(*participant_, [&] { return writer.matched() > 0; });
  }
  /// Deleting a writer drops its unsent data.
  static void linger() { std::this_thread::sleep_for(std::chrono::milliseconds(200)); }

  std::unique_ptr<DdsParticipant> participant_;
  std::vector<std::unique_ptr<DdsWriter>> writers_;
  std::vector<std::unique_ptr<DdsReader>> readers_;
  std::unique_ptr<DdsWriter> nodes_;
  std::thread server_;
  std::atomic<bool> stops_{false};
  std::atomic<std::size_t> answered_{0};
};

std::string obey(Attacker& attacker, const std::string& line) {
  std::istringstream words(line);
  std::string verb, topic, type;
  std::size_t count = 0, bytes = 0;
  words >> verb;
  if (verb == "malform") {
    words >> topic >> type;
    return attacker.malform(topic, type);
  }
  if (verb == "flood" || verb == "history") {
    std::string qos;
    words >> topic >> type >> qos >> bytes >> count;
    return attacker.flood(topic, type, qos_of(qos), bytes, count, verb == "history");
  }
  if (verb == "endpoints") {
    words >> count;
    return attacker.endpoints(count);
  }
  if (verb == "others" || verb == "churn") {
    words >> topic >> type >> count;
    return verb == "others" ? attacker.others(topic, type, count)
                            : attacker.churn(topic, type, count);
  }
  if (verb == "forget") return attacker.forget();
  if (verb == "nodes") return attacker.nodes();
  if (verb == "ask") {
    words >> topic >> count >> bytes;
    return attacker.ask(topic, count, bytes);
  }
  if (verb == "serve") {
    words >> topic;
    return attacker.serve(topic);
  }
  if (verb == "answered") return attacker.answered();
  if (verb == "garbage") {
    std::uint16_t port = 0;
    words >> port >> count;
    return Attacker::garbage(port, count);
  }
  return "unknown: " + line;
}

}  // namespace
}  // namespace agnocast::test

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  agnocast::test::Attacker attacker(static_cast<std::uint32_t>(std::stoul(argv[1])));
  for (std::string line; std::getline(std::cin, line);)
    std::cout << agnocast::test::obey(attacker, line) << std::endl;
}
