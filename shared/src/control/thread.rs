//! A thread between two frames of the host: its tension follows the grip, and it goes slack.
