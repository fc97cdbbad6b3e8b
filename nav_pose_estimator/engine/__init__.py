"""Stateful estimators without ROS: samples in, solutions and events out."""
