//! Mesh + cameras + photographs → a BlendedMVS scene.
