// A regression of a plane, for CPUs and GPUs.
#pragma once
#include "lfgpu.h"

// The value at a pixel of the plane through values, a regression about the middle of what counts.
//
// The nine sums are those of the weights, x, y, xx, xy, yy, and of the differences from the pixel's `value`, by x and
// by y. The ridge draws slopes to 0 that the window cannot tell.
inline float plane_at(float value, const float* s, float ridge) {
    const float inverse = 1.f / s[0], x = s[1] * inverse, y = s[2] * inverse, middle = s[6] * inverse;
    const float xx = s[3] * inverse - x * x + ridge, xy = s[4] * inverse - x * y;
    const float yy = s[5] * inverse - y * y + ridge;
    const float along_x = s[7] * inverse - x * middle, along_y = s[8] * inverse - y * middle;
    const float determinant = 1.f / (xx * yy - xy * xy);
    const float slope_x = (along_x * yy - along_y * xy) * determinant;
    const float slope_y = (along_y * xx - along_x * xy) * determinant;
    return value + middle - slope_x * x - slope_y * y;
}
