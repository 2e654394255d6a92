"""Isometry: bones keep their length. The term of Yang et al. 2020, Eq. 5, and its Gauss-Newton step, Eq. 20."""
