// SPDX-License-Identifier: Apache-2.0
//
// Writes agnocast-bridge(8) and bridge.toml(5) when the project is built, from the tables that --help and the reader
// of the configuration use.

#include <base/mdoc.hpp>
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
  return mdoc::heading("agnocast-bridge", "8", "topics and services of agnocast in a DDS domain",
                       date) +
         ".Sh SYNOPSIS\n.Nm\n.Op Ar option ...\n"
         ".Sh DESCRIPTION\n.Nm\n"
         "connects the topics and services of this host with a DDS domain, as nodes of ROS 2 are "
         "in it.\n"
         "A topic is bridged while both sides have somebody, with the same type;\n"
         ".Ic agnocast-ctl bridge list\nshows what is bridged, and what is not and why.\n"
         "It stays in the foreground, survives a restart of\n.Xr agnocastd 8 ,\n"
         "and may be killed and started again at any time.\n"
         ".Pp\nUnder systemd,\n.Pa agnocast-bridge.service\n"
         "serves the domain that the configuration says, and\n"
         ".Ic systemctl enable --now agnocast-bridge@7\n"
         "a further one, here 7.\n" +
         list("OPTIONS", "Fl", option_texts()) +
         ".Sh SIGNALS\n.Bl -tag -width Ds\n"
         ".It Dv SIGTERM , SIGINT\nEnd.\n"
         ".It Dv SIGHUP\nRead the configuration again: rules and log level hold from then on.\n"
         "One with mistakes changes nothing, and the log names them.\n.El\n" +
         list("ENVIRONMENT", "Ev", environment_texts()) +
         ".Sh FILES\n.Bl -tag -width Ds\n"
         ".It Pa /etc/agnocast/bridge.toml\nThe configuration, see\n.Xr bridge.toml 5 .\n"
         ".It Pa /etc/agnocast/bridge-N.toml\nIn its place, for\n.Fl Fl domain Ar N .\n"
         ".It Pa /etc/default/agnocast-bridge\nVariables of the environment, under systemd.\n"
         ".It Pa /run/agnocast-bridge/bridge-N.sock\nThe state, under systemd, for\n"
         ".Ic agnocast-ctl bridge .\n.El\n" +
         list("EXIT STATUS", "Li", exit_texts()) +
         ".Sh SEE ALSO\n.Xr agnocast-ctl 1 ,\n.Xr bridge.toml 5 ,\n.Xr agnocastd 8\n";
}

std::string configuration_page(const std::string& date) {
  std::string text = mdoc::heading("bridge.toml", "5", "configuration of agnocast-bridge", date) +
                     ".Sh DESCRIPTION\nA TOML file; every key may be left out.\n"
                     ".Ic agnocast-bridge --check-config\nfinds mistakes and says what to write.\n"
                     ".Bl -tag -width Ds\n";
  for (const ConfigKey& key : config_keys()) {
    text += ".It Va " + std::string(key.name) + '\n' +
            mdoc::lines_of(std::string(key.meaning) + " (" + std::string(key.value) + ").");
  }
  return text +
         ".El\n.Sh EXAMPLES\nOnly these topics, one of them for whoever may come:\n.Bd -literal\n"
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
