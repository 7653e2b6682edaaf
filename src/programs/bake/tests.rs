//! Tests of the bake.
