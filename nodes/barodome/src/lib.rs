//! Node for taxels in an elastic medium: frame to contacts.
