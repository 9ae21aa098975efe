//! Tests of the plant as a whole, and of its geometry against brute force.
