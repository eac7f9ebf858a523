# SPDX-License-Identifier: Apache-2.0
from ros2cli.command import CommandExtension

from ros2agnocast import agnocast_ctl


class AgnocastCommand(CommandExtension):
    """Inspect agnocast: its topics, services, nodes, processes and heaps (agnocast-ctl)."""

    def add_arguments(self, parser, cli_name):
        agnocast_ctl.add_words(parser)

    def main(self, *, parser, args):
        agnocast_ctl.become(args.words)
