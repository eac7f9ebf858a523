// SPDX-License-Identifier: Apache-2.0
//
// Writes agnocast-bridge(8) and bridge.toml(5) at build time, from the tables of --help and of the
// configuration reader.

#include <base/text/mdoc.hpp>
#include <bridge/program/config.hpp>
#include <bridge/program/options.hpp>

#include <cstdio>
#include <fstream>
#include <string>

namespace agnocast::bridge {
namespace {

std::string list(const std::string& section, const std::string& macro,
                 const std::vector<HelpText>& texts) {
  std::string text = ".Sh " + section + "\n.Bl -tag -width Ds\n";
  for (const HelpText& each : texts) {
    text += ".It " + (macro == "Fl" ? mdoc::flags_of(each.name) : macro + ' ' + each.name);
    if (!each.value.empty()) text += " Ar " + each.value;
    text += '\n' + mdoc::lines_of(each.meaning + '.');
  }
  return text + ".El\n";
}

std::string program_page(const std::string& date) {
  return mdoc::heading("agnocast-bridge", "8",
                       "connects topics and services of agnocast with a DDS domain", date) +
         ".Sh SYNOPSIS\n.Nm\n.Op Ar option ...\n"
         ".Sh DESCRIPTION\n.Nm\n"
         "connects the topics and services of this host with a DDS domain, in the way of ROS 2 "
         "nodes.\n"
         "A topic is bridged while both sides have an endpoint of the same type;\n"
         ".Ic agnocast-ctl bridge list\nshows what is bridged, what is not, and why.\n"
         "It stays in the foreground, survives a restart of\n.Xr agnocastd 8 ,\n"
         "and may be killed and started again at any time.\n"
         ".Pp\nUnder systemd,\n.Pa agnocast-bridge.service\n"
         "serves the domain of the configuration, and\n"
         ".Ic systemctl enable --now agnocast-bridge@7\n"
         "starts a bridge for a further domain, here 7.\n" +
         list("OPTIONS", "Fl", option_texts()) +
         ".Sh SIGNALS\n.Bl -tag -width Ds\n"
         ".It Dv SIGTERM , SIGINT\nEnd.\n"
         ".It Dv SIGHUP\nRead the configuration again and apply its rules and log level.\n"
         "A file with mistakes changes nothing, and the log names the mistakes.\n.El\n" +
         list("ENVIRONMENT", "Ev", environment_texts()) +
         ".Sh FILES\n.Bl -tag -width Ds\n"
         ".It Pa /etc/agnocast/bridge.toml\nThe configuration, see\n.Xr bridge.toml 5 .\n"
         ".It Pa /etc/agnocast/bridge-N.toml\nReplaces it for\n.Fl Fl domain Ar N .\n"
         ".It Pa /etc/default/agnocast-bridge\nEnvironment variables, under systemd.\n"
         ".It Pa /run/agnocast-bridge/bridge-N.sock\nThe status socket, under systemd, for\n"
         ".Ic agnocast-ctl bridge .\n.El\n" +
         list("EXIT STATUS", "Li", exit_texts()) +
         ".Sh SEE ALSO\n.Xr agnocast-ctl 1 ,\n.Xr bridge.toml 5 ,\n.Xr agnocastd 8\n";
}

std::string configuration_page(const std::string& date) {
  std::string text =
      mdoc::heading("bridge.toml", "5", "configuration of agnocast-bridge", date) +
      ".Sh DESCRIPTION\nA TOML file; every key is optional.\n"
      ".Ic agnocast-bridge --check-config\nfinds mistakes and prints the correct form.\n"
      ".Bl -tag -width Ds\n";
  for (const ConfigKey& key : config_keys()) {
    text += ".It Va " + std::string(key.name) + '\n' +
            mdoc::lines_of(std::string(key.meaning) + " (" + std::string(key.value) + ").");
  }
  return text +
         ".El\n.Sh EXAMPLES\nOnly these topics, one of them even without a subscriber:\n.Bd "
         "-literal\n"
         "default = \"none\"\n\n"
         "[[topic]]\nname = \"/lidar/**\"\ndirection = \"out\"\n"
         "to_dds = { reliability = \"best_effort\", depth = 1 }\n\n"
         "[[topic]]\nname = \"/map\"\ntype = \"nav_msgs/msg/OccupancyGrid\"\n"
         "direction = \"in\"\nalways = true\n.Ed\n"
         ".Sh SEE ALSO\n.Xr agnocast-bridge 8\n";
}

}  // namespace
}  // namespace agnocast::bridge

int main(int argc, char** argv) {
  using namespace agnocast::bridge;
  if (argc != 4) {
    std::fputs("usage: agnocast-bridge-manual-pages PAGE DATE FILE\n", stderr);
    return 2;
  }
  std::ofstream file(argv[3]);
  const bool is_program = std::string(argv[1]) == "agnocast-bridge.8";
  return file << (is_program ? program_page(argv[2]) : configuration_page(argv[2])) && file.flush()
             ? 0
             : 1;
}
