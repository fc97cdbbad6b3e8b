"""Compiled processing of observations that are as expected; their sensors take the results afterwards."""
