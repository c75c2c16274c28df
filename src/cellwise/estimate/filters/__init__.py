"""The filters: EKF, UKF, adaptive, and the two that do not filter (coulomb counting, rest OCV)."""
