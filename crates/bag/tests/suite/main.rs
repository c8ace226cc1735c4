//! Bags from outside: recorded, damaged, read by other people's readers.

mod bags;
mod clients;
mod full_disk;
mod recording;
mod versions;
