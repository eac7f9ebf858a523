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
using Step = SessionState::Step;

constexpr Phase phases[] = {Phase::unconnected, Phase::beginning, Phase::lost,    Phase::dropped,
                            Phase::moving,      Phase::arrived,   Phase::serving, Phase::alone};
constexpr Step steps[] = {Step::connected, Step::be_present, Step::drop,
                          Step::arrived,   Step::speak,      Step::lose};

/// The steps that lead a session to each phase.
const std::map<Phase, std::vector<Step>> ways{
    {Phase::unconnected, {}},
    {Phase::beginning, {}},
    {Phase::lost, {Step::lose}},
    {Phase::dropped, {Step::drop}},
    {Phase::moving, {Step::be_present}},
    {Phase::arrived, {Step::be_present, Step::arrived}},
    {Phase::serving, {Step::be_present, Step::arrived, Step::speak}},
    {Phase::alone, {Step::be_present, Step::lose}},
};

/// Constructed in place, because it has atomics.
struct In {
  explicit In(Phase phase) {
    former.give_reason(Errc::started_anew);
    if (phase != Phase::unconnected) state.begin_beside(former);
    for (const Step step : ways.at(phase)) EXPECT_TRUE(state.step(step));
    EXPECT_EQ(state.phase(), phase);
  }
  SessionState former, state;
};

TEST(SessionState, KnowsTheStepsOfTheDrawingAndNoOthers) {
  const std::map<std::pair<Phase, Step>, Phase> drawing{
      {{Phase::unconnected, Step::connected}, Phase::serving},
      {{Phase::unconnected, Step::lose}, Phase::alone},
      {{Phase::beginning, Step::be_present}, Phase::moving},
      {{Phase::beginning, Step::drop}, Phase::dropped},
      {{Phase::beginning, Step::lose}, Phase::lost},
      {{Phase::lost, Step::be_present}, Phase::alone},
      {{Phase::lost, Step::drop}, Phase::dropped},
      {{Phase::moving, Step::arrived}, Phase::arrived},
      {{Phase::moving, Step::lose}, Phase::alone},
      {{Phase::arrived, Step::speak}, Phase::serving},
      {{Phase::arrived, Step::lose}, Phase::alone},
      {{Phase::serving, Step::lose}, Phase::alone},
  };
  for (const Phase phase : phases) {
    for (const Step step : steps) {
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
  for (const Step step : {Step::be_present, Step::arrived, Step::speak}) {
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
    session.state.step(is_lost_first ? Step::lose : Step::be_present);
    session.state.step(is_lost_first ? Step::be_present : Step::lose);
    EXPECT_EQ(session.state.phase(), Phase::alone);
  }
}

}  // namespace
}  // namespace agnocast
