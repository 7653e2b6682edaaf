//! What people run on a scene or a result: each stands on the story and on no other program but those
//! that tests/architecture.rs names.

pub mod bake;
pub mod batch;
pub mod bench;
pub mod edit;
pub mod evaluate;
pub mod export;
pub mod prepare;
pub mod report;
pub mod run;
pub mod shards;
pub mod synth;
pub mod view;
