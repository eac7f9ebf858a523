// SPDX-License-Identifier: Apache-2.0
//
// verify: checks every invariant of the running system in several looks. An invariant is broken if
// every look found it so, in the same place with the same words. Subscriptions that are no longer
// served or have no doorbell are named as well; they break nothing and change no exit status.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/snapshot/audit.hpp>
#include <ctl/snapshot/pairs.hpp>
#include <ctl/snapshot/system.hpp>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

// Pauses between the looks. An operation in progress stays unfinished while its thread does not
// run, on an overloaded machine for tenths of a second, so the looks spread over more than two.
constexpr std::chrono::milliseconds pauses[] = {
    std::chrono::milliseconds(50),  std::chrono::milliseconds(100), std::chrono::milliseconds(200),
    std::chrono::milliseconds(400), std::chrono::milliseconds(600), std::chrono::milliseconds(800)};

const char* name_of(journal::Invariant invariant) noexcept {
  constexpr const char* names[] = {
#define AGNOCAST_INVARIANT_NAME(name, sentence) #name,
      AGNOCAST_INVARIANT_TABLE(AGNOCAST_INVARIANT_NAME)
#undef AGNOCAST_INVARIANT_NAME
  };
  return names[static_cast<std::uint8_t>(invariant)];
}

/// A subscription that gets less than others although no invariant is broken.
struct Exception {
  std::string topic;
  const char* kind;  // for programs
  wire::DumpProcess process;
  std::string process_name, why;
};

std::vector<Exception> exceptions_of(const System& system) {
  std::vector<Exception> found;
  const auto add = [&](const Topic& topic, const Endpoint& subscription, const char* kind,
                       std::string why) {
    if (const Process* const process = system.process_of(subscription); process != nullptr)
      found.push_back({topic.name, kind, process->facts, process->name, std::move(why)});
  };
  for (const auto& [index, topic] : system.topics) {
    for (const Pair& pair : pairs_of(system, topic)) {
      if (pair.state != PairState::withdrawn) continue;
      const std::string publisher = process_words_of(system, *pair.publisher);
      add(topic, *pair.subscription, word_of(pair.state),
          publisher.empty() ? pair.why : pair.why + ": " + publisher);
    }
    for (const Endpoint& subscription : topic.subscriptions) {
      if (subscription.state() == abi::BoardState::active && system.is_silent(subscription))
        add(topic, subscription, "mute", "it has no doorbell, it finds messages only by polling");
    }
  }
  return found;
}

struct Verification {
  Audit last;
  std::vector<Exception> exceptions;  // of the last look
  std::set<Finding> broken;
  std::size_t looks = 0;
  std::uint64_t processes = 0, topics = 0;
};

Outcome<Verification> look_until_sure(Observer& observer) {
  Verification verdict;
  for (;;) {
    auto system = observer.look();
    if (!system) return tl::unexpected(system.error());
    verdict.last = audit(*system, observer.region_bytes());
    verdict.exceptions = exceptions_of(*system);
    verdict.processes = system->processes.size();
    verdict.topics = system->topics.size();
    if (verdict.looks == 0) {
      verdict.broken = verdict.last.findings;
    } else {
      keep_what_lasts(verdict.broken, verdict.last);
    }
    if (++verdict.looks > std::size(pauses) || verdict.broken.empty()) return verdict;
    std::this_thread::sleep_for(pauses[verdict.looks - 1]);
  }
}

Object object_of(const Verification& verdict) {
  Object broken = Object::array();
  for (const Finding& finding : verdict.broken) {
    Object words = Object::array();
    for (const std::uint64_t word : finding.words) words.push_back(hexadecimal(word));
    broken.push_back({{"invariant", name_of(finding.invariant)},
                      {"where", finding.where},
                      {"sentence", journal::sentence_of(finding.invariant)},
                      {"words", words}});
  }
  Object exceptions = Object::array();
  for (const Exception& exception : verdict.exceptions)
    exceptions.push_back({{"topic", exception.topic},
                          {"kind", exception.kind},
                          {"process", exception.process_name},
                          {"pid", exception.process.pid},
                          {"uid", exception.process.uid},
                          {"reason", exception.why}});
  return {{"schema", "agnocast.verify/1"},
          {"holds", verdict.broken.empty()},
          {"looks", verdict.looks},
          {"processes", verdict.processes},
          {"topics", verdict.topics},
          {"queues", verdict.last.queues},
          {"queues_in_motion", verdict.last.in_motion.size()},
          {"links", verdict.last.links},
          {"broken", broken},
          {"not_broken_but", exceptions}};
}

void print(const Verification& verdict, Console& console) {
  for (const Finding& finding : verdict.broken) {
    std::string words;
    for (const std::uint64_t word : finding.words) words += ' ' + hexadecimal(word);
    console.line("broken: " + finding.where + ": " + name_of(finding.invariant) + ": " +
                 journal::sentence_of(finding.invariant) + " (" + words.substr(1) + ")");
  }
  for (const Exception& exception : verdict.exceptions)
    console.line("not broken, but: " + escaped(exception.topic) + ": subscription of " +
                 escaped(exception.process_name) + " (pid " +
                 std::to_string(exception.process.pid) + ", uid " +
                 std::to_string(exception.process.uid) + "): " + exception.kind + ": " +
                 exception.why);
  std::string checked = counted(verdict.processes, "process", "processes") + ", " +
                        counted(verdict.topics, "topic") + ", " +
                        counted(verdict.last.queues, "queue") + " at rest, ";
  if (!verdict.last.in_motion.empty())
    checked += std::to_string(verdict.last.in_motion.size()) + " in motion (checked in part), ";
  checked += counted(verdict.last.links, "link");
  console.line((verdict.broken.empty() ? "every invariant holds: " : "checked: ") + checked);
}

}  // namespace

Outcome<void> verify_system(const Arguments& arguments, Console& console) {
  auto observer = Observer::connect(arguments.socket);
  if (!observer) return tl::unexpected(observer.error());
  const auto verdict = look_until_sure(*observer);
  if (!verdict) return tl::unexpected(verdict.error());
  if (arguments.json == Json::no) {
    print(*verdict, console);
  } else {
    console.object(object_of(*verdict), arguments.json);
  }
  if (verdict->broken.empty()) return {};
  return problem(Status::check_failed, "verify",
                 counted(verdict->broken.size(), "invariant") +
                     (verdict->broken.size() == 1 ? " is broken" : " are broken"),
                 "restart the named process; keep the output of agnocast-ctl verify --json");
}

}  // namespace agnocast::ctl
