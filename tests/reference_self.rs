//! The float64 reference is judged by its properties, since nothing else can judge it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(
    dead_code,
    unreachable_pub,
    reason = "every test file includes the whole reference and uses a part of it"
)]
mod reference;
