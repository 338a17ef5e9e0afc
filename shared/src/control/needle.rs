//! A needle between two frames of the host: it sticks, slides and punctures by itself.
