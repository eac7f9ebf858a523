// SPDX-License-Identifier: Apache-2.0
//
// Goal: the class follows the drawing and the table of properties in session_state.hpp. Method:
// every phase with every step, and the sequences that occur.

#include <client/session/session_state.hpp>

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Phase = SessionState::Phase;
using Transition = SessionState::Step;

constexpr Phase phases[] = {Phase::unconnected, Phase::beginning, Phase::lost,    Phase::dropped,
                            Phase::moving,      Phase::arrived,   Phase::serving, Phase::alone};
constexpr Transition steps[] = {Transition::connected, Transition::be_present, Transition::drop,
                                Transition::arrived,   Transition::speak,      Transition::lose};

/// The steps that lead a session to each phase.
const std::map<Phase, std::vector<Transition>> ways{
    {Phase::unconnected, {}},
    {Phase::beginning, {}},
    {Phase::lost, {Transition::lose}},
    {Phase::dropped, {Transition::drop}},
    {Phase::moving, {Transition::be_present}},
    {Phase::arrived, {Transition::be_present, Transition::arrived}},
    {Phase::serving, {Transition::be_present, Transition::arrived, Transition::speak}},
    {Phase::alone, {Transition::be_present, Transition::lose}},
};

/// Constructed in place, because it has atomics.
struct In {
  explicit In(Phase phase) {
    former.give_reason(Errc::started_anew);
    if (phase != Phase::unconnected) state.begin_beside(former);
    for (const Transition step : ways.at(phase)) EXPECT_TRUE(state.step(step));
    EXPECT_EQ(state.phase(), phase);
  }
  SessionState former, state;
};

TEST(SessionState, KnowsTheStepsOfTheDrawingAndNoOthers) {
  const std::map<std::pair<Phase, Transition>, Phase> drawing{
      {{Phase::unconnected, Transition::connected}, Phase::serving},
      {{Phase::unconnected, Transition::lose}, Phase::alone},
      {{Phase::beginning, Transition::be_present}, Phase::moving},
      {{Phase::beginning, Transition::drop}, Phase::dropped},
      {{Phase::beginning, Transition::lose}, Phase::lost},
      {{Phase::lost, Transition::be_present}, Phase::alone},
      {{Phase::lost, Transition::drop}, Phase::dropped},
      {{Phase::moving, Transition::arrived}, Phase::arrived},
      {{Phase::moving, Transition::lose}, Phase::alone},
      {{Phase::arrived, Transition::speak}, Phase::serving},
      {{Phase::arrived, Transition::lose}, Phase::alone},
      {{Phase::serving, Transition::lose}, Phase::alone},
  };
  for (const Phase phase : phases) {
    for (const Transition step : steps) {
      const auto arrow = drawing.find({phase, step});
      const Phase expected = arrow != drawing.end() ? arrow->second : phase;
      In session(phase);
      EXPECT_EQ(session.state.step(step), arrow != drawing.end())
          << static_cast<int>(phase) << " " << static_cast<int>(step);
      EXPECT_EQ(session.state.phase(), expected)
          << static_cast<int>(phase) << " " << static_cast<int>(step);
    }
  }
}

TEST(SessionState, HasThePropertiesOfItsTable) {
  const auto is_in = [](Phase phase, std::set<Phase> set) { return set.count(phase) != 0; };
  for (const Phase phase : phases) {
    SCOPED_TRACE(static_cast<int>(phase));
    const In session(phase);
    EXPECT_EQ(session.state.is_connected(), !is_in(phase, {Phase::unconnected, Phase::dropped}));
    EXPECT_EQ(session.state.is_beginning(), is_in(phase, {Phase::beginning, Phase::lost}));
    EXPECT_EQ(session.state.is_dropped(), phase == Phase::dropped);
    EXPECT_EQ(session.state.is_alone(), is_in(phase, {Phase::lost, Phase::alone}));
    EXPECT_EQ(session.state.may_end_by_itself(), phase == Phase::alone);
    EXPECT_EQ(session.state.speaks(),
              is_in(phase, {Phase::unconnected, Phase::serving, Phase::alone}));
  }
}

TEST(SessionState, NotifiesOfEachChangeOnce) {
  SessionState state;
  EXPECT_EQ(state.connection(), ConnectionState::unconnected);
  EXPECT_TRUE(state.tell(ConnectionState::connected));
  EXPECT_FALSE(state.tell(ConnectionState::connected));
  EXPECT_TRUE(state.tell(ConnectionState::reconnecting));
  EXPECT_EQ(state.connection(), ConnectionState::reconnecting);
  EXPECT_TRUE(state.give_reason(Errc::revoked));
  EXPECT_FALSE(state.give_reason(Errc::revoked));
  EXPECT_EQ(state.reason(), Errc::revoked);
}

TEST(SessionState, StaysOrphanedForThePreviousReasonUntilItSpeaks) {
  In session(Phase::beginning);
  SessionState& state = session.state;
  for (const Transition step : {Transition::be_present, Transition::arrived, Transition::speak}) {
    EXPECT_FALSE(state.tell(ConnectionState::connected));
    EXPECT_EQ(state.connection(), ConnectionState::orphaned);
    EXPECT_EQ(state.reason(), Errc::started_anew);
    EXPECT_TRUE(state.step(step));
  }
  EXPECT_TRUE(state.tell(ConnectionState::connected));
}

// The control thread loses the session while another thread makes it the current one.
TEST(SessionState, IsAloneWhetherItIsLostBeforeOrAfterItBecomesCurrent) {
  for (const bool is_lost_first : {false, true}) {
    In session(Phase::beginning);
    session.state.step(is_lost_first ? Transition::lose : Transition::be_present);
    session.state.step(is_lost_first ? Transition::be_present : Transition::lose);
    EXPECT_EQ(session.state.phase(), Phase::alone);
  }
}

}  // namespace
}  // namespace agnocast
