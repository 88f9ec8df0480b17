// Decides whether a step is taken: word0 0, after its loss: whether rows must be checked; word0 1, after that check:
// whether the model changes.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"

void main() {
    if (lane() != 0)
        return;
    uint overflow = frame.counters.at[GS_COUNT_OVERFLOW];
    if (push.word0 == 0) {
        bool halted = training.state.at[GS_STATE_HALT] != 0;
        bool sane = training.sane.at[0] != 0 && training.term_is_sane != 0;
        training.state.at[GS_STATE_OVERFLOW] = halted ? 0 : overflow;
        training.state.at[GS_STATE_CLAMP] = !halted && overflow == 0 && !sane && training.updates != 0 ? 1u : 0u;
        training.state.at[GS_STATE_SKIP] = halted || overflow != 0 ? 1u : 0u;
        training.state.at[GS_STATE_BAD_ROWS] = training.state.at[GS_STATE_LOST_ROWS] = 0;
        training.state.at[GS_STATE_VISIBLE] = frame.counters.at[GS_COUNT_VISIBLE];
        training.state.at[GS_STATE_ENTRIES] = frame.counters.at[GS_COUNT_ENTRIES];
        if (overflow != 0)
            training.state.at[GS_STATE_HALT] = 1;
    } else if (training.state.at[GS_STATE_CLAMP] != 0) {
        bool infinite = training.sane.at[1] != 0 || training.term_is_sane == 0; // the loss
        if (infinite || training.state.at[GS_STATE_LOST_ROWS] != 0)
            training.state.at[GS_STATE_SKIP] = 1;
    }
}
