"""Tests of the INS: the AUV navigator with its own filter."""
