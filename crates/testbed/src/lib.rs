//! Virtual testbed: stimulus plans and other people's recordings become labelled bags; a model stands behind a real transport.
