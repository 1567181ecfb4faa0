"""The robot: elements, drives, and how a tree is built from them."""
