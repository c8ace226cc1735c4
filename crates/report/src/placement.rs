//! Where to put sensing elements.

mod page;
mod text;

pub use page::html;
pub use text::{taxels, text};
