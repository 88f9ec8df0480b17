// What all shaders share: buffers, the frame of a draw, the push constants.
#extension GL_EXT_buffer_reference : require

// All are aligned by 16, although words need 4: the compiler takes an address that it loads from memory to be aligned as
// what it points to.
layout(buffer_reference, std430, buffer_reference_align = 16) buffer gs_words { uint at[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) buffer gs_floats { float at[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_quads { vec4 at[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) buffer gs_quads_out { vec4 at[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) buffer gs_records { uvec4 at[]; };

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_frame_block;
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_step_block;
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_loss_block;
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_noise_block;

// MoltenVK mishandles 3-vectors behind pointers; tools/build/shaders.py refuses them.
#define gs_vec3 float[3]

#include "constants.h"
#include "step.h"
#include "loss_frame.h"
#include "model_push.h"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_frame_block {
    gs_frame frame;
};

// A shader with push constants of its own defines their struct.
#ifndef GS_PUSH
#define GS_PUSH gs_push
#endif

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_step_block {
    gs_step of;
};

layout(push_constant) uniform gs_push_block {
    GS_PUSH push;
};

#define frame push.block.frame
#define training frame.step_block.of

layout(local_size_x = GS_GROUP) in;

// Number of this workgroup: a dispatch of more than 65535 is folded into rows.
uint group_number() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }
uint lane() { return gl_LocalInvocationIndex; }
