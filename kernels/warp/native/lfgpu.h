// Types of the arguments that Warp gives to the functions of this folder.
//
// `../native_code.py` says how it reads these files: every function begins and ends in the first column, `inline`
// functions are for other functions, and names in capitals that are not defined here are defined by Python.
#pragma once
#include <builtin.h>

template <typename T> using Array1 = wp::array_t<T>;
template <typename T> using Array2 = wp::array_t<T>;
template <typename T> using Array3 = wp::array_t<T>;
template <typename T> using Array4 = wp::array_t<T>;
using Number = float;  // given by Python, or a scalar on the device
using wp::uint16;
using wp::uint32;
using wp::vec2f;
using wp::vec2i;
using wp::vec4f;
