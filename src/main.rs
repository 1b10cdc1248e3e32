//! stein
fn main() {}
