"""The ground's heights about a focal plane, found where rays of the ground agree."""
