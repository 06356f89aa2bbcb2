"""What beams say: free lines of sight, what lies behind, what was seen through, and what ended where."""
