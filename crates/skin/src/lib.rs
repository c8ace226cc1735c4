//! Vocabulary of tactile skins: surface, taxel, frame, stimulus, contact, force map.
