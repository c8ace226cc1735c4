//! What a skin can know at best.

mod page;
mod text;

pub use page::html;
pub use text::text;
