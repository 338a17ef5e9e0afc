//! What the files of scenes and devices may say, key by key: read, and not yet checked.
//!
//! Entry points: [`SceneFile::read`](scene::SceneFile::read), [`DeviceFile::read`](device::DeviceFile::read). A crate of its own
//! because it is a third of what would be compiled anew with every change of the solver. Everything that is generic over who
//! reads is made here, once.

pub mod device;
pub mod jaws;
pub mod scene;
pub mod wound;
