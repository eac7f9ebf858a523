// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>
#include <ctl/cli/message_options.hpp>
#include <ctl/commands/live.hpp>
#include <ctl/snapshot/select.hpp>

#include <poll.h>
#include <signal.h>
#include <sys/signalfd.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <utility>

namespace agnocast::ctl {
namespace {

namespace o = options;

// 64 MiB of YAML become some 8 MiB of message and a GiB of nodes in the parser.
constexpr std::size_t text_bytes_max = 64 << 20;

Status status_of(Errc code) {
  switch (code) {
    case Errc::daemon_not_running:
      return Status::not_reachable;
    case Errc::permission_denied:
    case Errc::access_denied:
    case Errc::daemon_untrusted:
      return Status::permission_denied;
    case Errc::type_not_found:
      return Status::no_such_thing;
    case Errc::invalid_name:
    case Errc::invalid_argument:
    case Errc::depth_refused:
      return Status::wrong_usage;
    default:
      return Status::failed;
  }
}

QoS profile_of(const std::string& name) {
  if (name == "sensor_data") return QoS(5).best_effort();
  if (name == "parameters" || name == "parameter_events") return QoS(1000);
  if (name == "action_status_default") return QoS(1).transient_local();
  if (name == "system_default") return QoS(1);
  return QoS(10);  // default, services_default, best_available
}

Outcome<std::string> text_in(std::FILE* file, const std::string& name) {
  std::string text;
  char letters[1 << 16];
  for (std::size_t count; (count = std::fread(letters, 1, sizeof letters, file)) > 0;) {
    text.append(letters, count);
    if (text.size() > text_bytes_max)
      return problem(Status::failed, escaped(name), "longer than 64 MiB", "write it in parts");
  }
  if (std::ferror(file) != 0)
    return problem_of({Errc::os_failure, errno, "reading", 0}, escaped(name));
  return text;
}

}  // namespace

tl::unexpected<Problem> problem_of(const Failure& failure, const std::string& what) {
  return problem(status_of(failure.code), what, text_of(failure), remedy_of(failure.code));
}

void note(const std::string& text) { std::fprintf(stderr, "agnocast-ctl: %s\n", text.c_str()); }

Outcome<std::unique_ptr<Live>> Live::enter(const Arguments& arguments,
                                           const std::string& node_name) {
  // Environment variables for nodes must not affect the tool.
  ::setenv("AGNOCAST_SOCKET", arguments.socket.c_str(), 1);
  ::setenv("ROS_DOMAIN_ID", std::to_string(arguments.domain).c_str(), 1);
  ::unsetenv("AGNOCAST");
  ::unsetenv("AGNOCAST_SCOPE");
  ::unsetenv("AGNOCAST_HEAP_IDLE_SECONDS");
  std::unique_ptr<Live> live(new Live);
  sigset_t ends;
  ::sigemptyset(&ends);
  ::sigaddset(&ends, SIGINT);
  ::sigaddset(&ends, SIGTERM);
  ::sigprocmask(SIG_BLOCK, &ends, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
  live->signals_.reset(::signalfd(-1, &ends, SFD_CLOEXEC));
  if (live->signals_.get() < 0)
    return problem_of({Errc::os_failure, errno, "signalfd", 0}, "signals");
  try {
    // A leading underscore hides the node's name, as for ros2's own tools.
    live->node_.emplace(
        node_name.empty() ? "_agnocast_ctl_" + std::to_string(::getpid()) : node_name,
        NodeOptions().use_global_arguments(false));
    live->executor_.emplace();
    live->executor_->add_node(*live->node_);
  } catch (const Error& error) {
    return problem_of(error.failure(), node_name.empty() ? "node" : escaped(node_name));
  }
  return live;
}

bool Live::run_until(Clock::time_point deadline) {
  is_stopped_ = false;
  for (;;) {
    const bool has_work = executor_->prepare() == Executor::Readiness::work_ready;
    // A far deadline is waited for in parts: fd() ends each wait once a second anyway.
    auto patience = std::chrono::milliseconds(0);
    if (!has_work)
      patience = deadline == for_ever
                     ? std::chrono::milliseconds(-1)
                     : std::clamp<std::chrono::milliseconds>(
                           std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()),
                           patience, std::chrono::hours(1));
    pollfd waited[] = {{signals_.get(), POLLIN, 0}, {executor_->fd(), POLLIN, 0}};
    if (::poll(waited, 2, static_cast<int>(patience.count())) > 0 && waited[0].revents != 0)
      return false;
    executor_->dispatch();
    if (is_stopped_ || Clock::now() >= deadline) return true;
  }
}

bool Live::is_ended_by_signal() const {
  pollfd waited{signals_.get(), POLLIN, 0};
  return ::poll(&waited, 1, 0) > 0;
}

bool write_out() {
  if (std::fflush(stdout) == 0 || errno != EPIPE) return true;
  std::FILE* const nowhere = std::freopen("/dev/null", "w", stdout);
  if (nowhere != nullptr) std::clearerr(nowhere);
  return false;
}

ChosenQos qos_of(const Arguments& arguments, const char* default_profile,
                 const std::vector<Endpoint>* adapted) {
  const std::string named = arguments.text(o::qos_profile);
  ChosenQos chosen{profile_of(named.empty() ? default_profile : named), {}};
  QoS& qos = chosen.qos;
  const std::string history = arguments.text(o::qos_history);
  const std::string reliability = arguments.text(o::qos_reliability);
  const std::string durability = arguments.text(o::qos_durability);
  if (arguments.has(o::qos_depth)) qos.keep_last(arguments.whole(o::qos_depth));
  if (history == "keep_all") qos.keep_all();
  if (reliability == "best_effort") qos.best_effort();
  // The best reliability that all publishers offer.
  if (reliability == "best_available" && adapted != nullptr) qos.best_effort();
  if (reliability == "reliable" || reliability == "system_default") qos.reliable();
  if (durability == "transient_local") qos.transient_local();
  if (!durability.empty() && durability != "transient_local") qos.durability_volatile();
  const bool is_told = arguments.has(o::qos_depth) || !history.empty() || !reliability.empty() ||
                       !durability.empty();
  if (adapted == nullptr || adapted->empty() || is_told) return chosen;
  const auto all = static_cast<std::ptrdiff_t>(adapted->size());
  const auto count = [&](auto has) { return std::count_if(adapted->begin(), adapted->end(), has); };
  const auto reliable =
      count([](const Endpoint& endpoint) { return abi::unpack_qos(endpoint.facts.qos).reliable; });
  const auto kept = count(
      [](const Endpoint& endpoint) { return abi::unpack_qos(endpoint.facts.qos).transient_local; });
  reliable == all ? qos.reliable() : qos.best_effort();
  kept == all ? qos.transient_local() : qos.durability_volatile();
  if (reliable != 0 && reliable != all)
    chosen.note = "some publishers are reliable and some best effort; using best effort for all";
  if (kept != 0 && kept != all)
    chosen.note += std::string(chosen.note.empty() ? "" : "; ") +
                   "some publishers are transient local and some volatile; using volatile for all";
  return chosen;
}

Outcome<std::string> values_of(const Arguments& arguments) {
  const std::string file = arguments.text(o::yaml_file);
  const int sources = (arguments.subject(2).empty() ? 0 : 1) + (file.empty() ? 0 : 1) +
                      (arguments.has(o::from_stdin) ? 1 : 0);
  if (sources > 1)
    return problem(Status::wrong_usage, "VALUES", "use only one of VALUES, --stdin and --yaml-file",
                   full_name(*arguments.command) + " --help");
  if (arguments.has(o::from_stdin)) return text_in(stdin, "standard input");
  if (file.empty()) return arguments.subject(2).empty() ? "{}" : arguments.subject(2);
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> opened(std::fopen(file.c_str(), "re"),
                                                               std::fclose);
  if (opened == nullptr) return problem_of({Errc::os_failure, errno, "opening", 0}, escaped(file));
  return text_in(opened.get(), file);
}

std::int64_t wall_time_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

Outcome<TopicNow> topic_now(const Arguments& arguments) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto topic = find_topic(look->system, arguments, arguments.subject(0));
  if (!topic) return tl::unexpected(topic.error());
  TopicNow now{(*topic)->type, (*topic)->facts.layout_hash, {}};
  for (const Endpoint& publisher : (*topic)->publishers) {
    if (publisher.state() == abi::BoardState::active) now.publishers.push_back(publisher);
  }
  return now;
}

}  // namespace agnocast::ctl
