//! Programs, devices and other people's clients together: one binary, because each would link the whole stack once more.
//! What needs ROS 2 in the program is a binary of its own beside it.

mod bags;
mod browser;
mod camera;
mod collect;
mod container;
mod corpus;
mod ert;
mod examples;
mod faults;
mod fusion;
mod gap;
mod gap_check;
mod gap_faults;
mod hapdef;
mod insight;
mod instances;
mod launch;
mod layouts;
mod limits;
mod losses;
mod models;
mod network;
mod planners;
mod recorded;
mod reflex;
mod rmw_zenoh;
mod security;
mod sentences;
mod soak;
mod supervision;
mod toys;
mod training;
mod verify;
mod watch;
mod zenoh;
