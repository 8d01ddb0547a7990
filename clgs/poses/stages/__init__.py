"""The stages of structure from motion, each on a workspace: features to models."""
